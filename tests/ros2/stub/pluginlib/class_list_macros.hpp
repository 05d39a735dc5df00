#pragma once
#include <memory>

// A factory in the place of the loader's table.
#define PLUGINLIB_EXPORT_CLASS(Kind, Base)                 \
    std::unique_ptr<Base> plugin_made();                   \
    std::unique_ptr<Base> plugin_made() { return std::make_unique<Kind>(); }
