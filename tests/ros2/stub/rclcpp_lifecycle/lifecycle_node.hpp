#pragma once
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "std_msgs/msg/float64.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"
#include "std_srvs/srv/trigger.hpp"

namespace rclcpp_lifecycle {

using Value = std::variant<std::string, double, bool, std::vector<std::string>, std::vector<double>>;

// A parameter refuses to be read as another type, as that of rclcpp does.
struct Parameter {
    Value value;
    std::string as_string() const { return std::get<std::string>(value); }
    double as_double() const { return std::get<double>(value); }
    bool as_bool() const { return std::get<bool>(value); }
    std::vector<std::string> as_string_array() const { return std::get<std::vector<std::string>>(value); }
    std::vector<double> as_double_array() const { return std::get<std::vector<double>>(value); }
    template <typename T>
    T get_value() const {
        return std::get<T>(value);
    }
};

class LifecycleNode {
public:
    explicit LifecycleNode(std::string name) : name_(std::move(name)) {}
    const char * get_name() const { return name_.c_str(); }
    rclcpp::Logger get_logger() const { return {&said}; }
    bool has_parameter(const std::string & name) const { return parameters.count(name) > 0; }
    Parameter get_parameter(const std::string & name) const {
        if (!has_parameter(name)) throw std::runtime_error("parameter " + name + " is not declared");
        return {parameters.at(name)};
    }
    template <typename T>
    T declare_parameter(const std::string & name, const T & value) {
        parameters[name] = value;
        return value;
    }
    template <typename Message, typename Callback>
    typename rclcpp::Subscription<Message>::SharedPtr create_subscription(
        const std::string & topic, const rclcpp::SystemDefaultsQoS &, Callback && callback) {
        auto made = std::make_shared<rclcpp::Subscription<Message>>();
        made->callback = callback;
        if constexpr (std::is_same_v<Message, std_msgs::msg::Float64>) {
            if (topic == "~/target") target = made;
        } else if (topic == "~/target") {
            targets = made;
        }
        return made;
    }
    template <typename Type, typename Callback>
    typename rclcpp::Service<Type>::SharedPtr create_service(const std::string & name, Callback && callback) {
        auto made = std::make_shared<rclcpp::Service<Type>>();
        made->callback = callback;
        if (name == "~/stop") stop = made;
        return made;
    }

    std::map<std::string, Value> parameters;
    std::weak_ptr<rclcpp::Subscription<std_msgs::msg::Float64>> target;
    std::weak_ptr<rclcpp::Subscription<std_msgs::msg::Float64MultiArray>> targets;
    std::weak_ptr<rclcpp::Service<std_srvs::srv::Trigger>> stop;
    mutable std::string said;

private:
    std::string name_;
};

namespace node_interfaces {

class LifecycleNodeInterface {
public:
    enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
    virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
    virtual ~LifecycleNodeInterface() = default;
};

}  // namespace node_interfaces

}  // namespace rclcpp_lifecycle
