// As much of rclcpp as a controller of ros2_control uses, for tests without ROS. Signatures are those of ROS 2 Jazzy.
#pragma once
#include <cstdio>
#include <functional>
#include <memory>
#include <string>

namespace rclcpp {

struct Time {};
struct Duration {
    double length_s = 0.0;
    double seconds() const { return length_s; }
};
struct SystemDefaultsQoS {};
struct Logger {
    std::string * said;
};

template <typename Message>
struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(const Message &)> callback;
};

template <typename Type>
struct Service {
    using SharedPtr = std::shared_ptr<Service>;
    std::function<void(std::shared_ptr<typename Type::Request>, std::shared_ptr<typename Type::Response>)> callback;
};

}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...)                          \
    do {                                                   \
        char line[1024];                                   \
        std::snprintf(line, sizeof line, __VA_ARGS__);     \
        *(logger).said = line;                             \
    } while (0)
