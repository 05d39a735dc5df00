// A ros2_control controller around the C that `hystmpc export-c` writes.
#ifndef HYSTMPC_CONTROLLER__CONTROLLER_HPP_
#define HYSTMPC_CONTROLLER__CONTROLLER_HPP_

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "hystmpc.h"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "std_msgs/msg/float64.hpp"
#include "std_srvs/srv/trigger.hpp"

namespace hystmpc_control {

// One tip angle, driven by one command. The wanted angle comes from the topic ~/target, or from a controller before
// this one by the reference interface. An update takes no memory and waits for nothing. What it writes is a finite command
// within the limits that were exported, on rate from what stands at the command interface. It writes nothing where another
// has written there, or after a pause, and goes on from there in the next one; and nothing where that is no admissible
// command.
class HystmpcController final : public controller_interface::ChainableControllerInterface {
public:
    controller_interface::CallbackReturn on_init() override;
    controller_interface::InterfaceConfiguration command_interface_configuration() const override;
    controller_interface::InterfaceConfiguration state_interface_configuration() const override;
    // Reads the parameters; refuses another update rate than that of the exported controller.
    controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
    // Starts at rest at the measured angle, under the command that the device holds. That angle is the reference.
    controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
    // Latches the stop and writes its command, one sample towards the safe one; `deactivate_at_once` writes that itself.
    controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
    controller_interface::CallbackReturn on_cleanup(const rclcpp_lifecycle::State & previous) override;

protected:
    std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
    bool on_set_chained_mode(bool chained_mode) override;
    controller_interface::return_type update_reference_from_subscribers(
        const rclcpp::Time & time, const rclcpp::Duration & period) override;
    controller_interface::return_type update_and_write_commands(
        const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
    controller_interface::CallbackReturn refused(const std::string & why) const;
    double measured_deg() const;
    double told_command() const;
    double held_command() const;
    double samples_since_the_last(double period_s);
    static bool same(double one, double other);
    static bool admissible(double command);
    void write(double command);

    std::unique_ptr<hystmpc_controller> controller_;
    std::string command_name_, state_name_, joint_;
    double to_deg_ = 1.0;         // of a unit of the state interface
    double command_scale_ = 1.0;  // units of the command interface in one mm or bar
    double start_command_ = 0.0;  // where the command interface has no number yet; not-a-number for none [mm or bar]
    double least_angle_ = 0.0, greatest_angle_ = 0.0;  // of the sensor, in the state's unit; not-a-number for none
    double sent_ = 0.0;    // last command written, or found there [mm or bar]; not-a-number where it is not known
    double waited_ = 0.0;  // since the last command [samples]; not-a-number before the first update
    bool deactivate_at_once_ = false;

    std::atomic<double> target_{0.0};  // last message, in the state's unit; not-a-number before the first
    std::atomic<bool> stop_{false};
    rclcpp::Subscription<std_msgs::msg::Float64>::SharedPtr target_subscription_;
    rclcpp::Service<std_srvs::srv::Trigger>::SharedPtr stop_service_;
};

}  // namespace hystmpc_control

#endif  // HYSTMPC_CONTROLLER__CONTROLLER_HPP_
