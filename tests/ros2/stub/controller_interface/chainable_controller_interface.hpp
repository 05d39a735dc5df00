#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hardware_interface/handle.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

namespace controller_interface {

using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;
enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names = {};
};

class ControllerInterfaceBase : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface {
public:
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_init() = 0;
    virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
    std::shared_ptr<const rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
    unsigned int get_update_rate() const { return update_rate_; }
    template <typename T>
    auto auto_declare(const std::string & name, const T & value) {
        return node_->has_parameter(name) ? node_->get_parameter(name).get_value<T>()
                                          : node_->declare_parameter<T>(name, value);
    }
    // What the controller manager does.
    CallbackReturn init(const std::string & name, unsigned int update_rate) {
        node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>(name);
        update_rate_ = update_rate;
        return on_init();
    }
    void assign_interfaces(
        std::vector<hardware_interface::LoanedCommandInterface> && commands,
        std::vector<hardware_interface::LoanedStateInterface> && states) {
        command_interfaces_ = std::move(commands);
        state_interfaces_ = std::move(states);
    }
    void release_interfaces() {
        command_interfaces_.clear();
        state_interfaces_.clear();
    }

protected:
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
    unsigned int update_rate_ = 0;
};

class ChainableControllerInterface : public ControllerInterfaceBase {
public:
    return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) final {
        if (!chained_ && update_reference_from_subscribers(time, period) != return_type::OK) return return_type::ERROR;
        return update_and_write_commands(time, period);
    }
    std::vector<hardware_interface::CommandInterface> export_reference_interfaces() {
        return on_export_reference_interfaces();
    }
    bool set_chained_mode(bool chained) {
        if (on_set_chained_mode(chained)) chained_ = chained;
        return chained_ == chained;
    }

protected:
    virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
    virtual bool on_set_chained_mode(bool chained_mode) = 0;
    virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    std::vector<double> reference_interfaces_;

private:
    bool chained_ = false;
};

}  // namespace controller_interface
