#pragma once
#include <optional>
#include <string>

namespace hardware_interface {

class Handle {
public:
    Handle(const std::string & prefix, const std::string & name, double * value)
        : prefix_(prefix), name_(prefix + "/" + name), value_(value) {}
    const std::string & get_name() const { return name_; }
    const std::string & get_prefix_name() const { return prefix_; }
#ifdef STUB_OLD_INTERFACES  // as in releases before get_optional
    double get_value() const { return *value_; }
    void set_value(double value) { *value_ = value; }
#else
    template <typename T = double>
    [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const {
        return *value_;
    }
    template <typename T>
    [[nodiscard]] bool set_value(const T & value, unsigned int = 10) {
        *value_ = value;
        return true;
    }
#endif

private:
    std::string prefix_, name_;
    double * value_;
};

class CommandInterface : public Handle {
public:
    using Handle::Handle;
    CommandInterface(const CommandInterface &) = delete;
    CommandInterface(CommandInterface &&) = default;
};

using LoanedCommandInterface = CommandInterface;
using LoanedStateInterface = Handle;

}  // namespace hardware_interface
