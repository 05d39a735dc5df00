// A ros2_control controller around the C that `hystmpc export-c` writes.
#ifndef HYSTMPC_CONTROLLER__CONTROLLER_HPP_
#define HYSTMPC_CONTROLLER__CONTROLLER_HPP_

#include <array>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "hystmpc_controller/engine.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "std_msgs/msg/float64.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"
#include "std_srvs/srv/trigger.hpp"

namespace hystmpc_control {

#ifdef HYSTMPC_AXES
using Target = std_msgs::msg::Float64MultiArray;  // of two axes: x and y
#else
using Target = std_msgs::msg::Float64;
#endif

// One tip angle, driven by one command; or two angles, driven by several commands, where the exported C has two axes.
// The wanted angles come from the topic ~/target, or from a controller before this one by the reference interfaces. An update takes no memory and waits for nothing. What it writes is a finite command
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
    std::string read_names();
    void put_target(const Angles & angles);
    Angles measured_deg() const;
    Commands told_command() const;
    Commands held_command() const;
    double samples_since_the_last(double period_s);
    bool claimed() const;
    static bool same(const Commands & one, const Commands & other);
    static bool admissible(const Commands & commands);
    void write(const Commands & commands);

    std::unique_ptr<hystmpc_controller> controller_;
    std::vector<std::string> command_names_, state_names_, joints_;
    double to_deg_ = 1.0;         // of a unit of the state interface
    double command_scale_ = 1.0;  // units of the command interface in one mm or bar
    Commands start_command_{};    // where a command interface has no number yet; not-a-number for none [mm or bar]
    double least_angle_ = 0.0, greatest_angle_ = 0.0;  // of the sensor, in the state's unit; not-a-number for none
    Commands sent_{};      // last command written, or found there [mm or bar]; not-a-number where it is not known
    double waited_ = 0.0;  // since the last command [samples]; not-a-number before the first update
    bool deactivate_at_once_ = false;

    std::array<std::atomic<double>, AXES> target_{};  // last message, in the state's unit; not-a-number before the first
    std::atomic<unsigned> target_count_{0};           // odd while a message is being put there
    std::atomic<bool> stop_{false};
    rclcpp::Subscription<Target>::SharedPtr target_subscription_;
    rclcpp::Service<std_srvs::srv::Trigger>::SharedPtr stop_service_;
};

}  // namespace hystmpc_control

#endif  // HYSTMPC_CONTROLLER__CONTROLLER_HPP_
