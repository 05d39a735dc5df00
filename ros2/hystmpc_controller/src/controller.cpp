#include "hystmpc_controller/controller.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "pluginlib/class_list_macros.hpp"

namespace hystmpc_control {

namespace {

using controller_interface::CallbackReturn;
using controller_interface::interface_configuration_type;
using controller_interface::InterfaceConfiguration;
using controller_interface::return_type;

constexpr double NONE = std::numeric_limits<double>::quiet_NaN();
constexpr double SAME_RATE = 1e-6;      // share of the rate
constexpr double SAME_COMMAND = 1e-6;   // share of the range: a command that was converted to another unit and back
constexpr int MOST_STOP_STEPS = 10000;  // of a ramp to the safe command
constexpr double SHORTEST = 0.5;        // of a sample: time between two commands at least
constexpr double GAP = 4.0;             // samples without an update after which nothing is sent at once
constexpr int MOST_MISSED = 50;         // samples of a pause that the model is led through
static_assert(std::atomic<double>::is_always_lock_free, "an update must not wait");

// The number behind an interface; older releases of ros2_control have no get_optional.
template <typename Interface>
auto value_of(const Interface & interface, int) -> decltype(interface.get_optional().value_or(NONE)) {
    return interface.get_optional().value_or(NONE);
}
template <typename Interface>
double value_of(const Interface & interface, long) {
    return interface.get_value();
}

// Length of a period [s]; not-a-number where it says none.
template <typename Period>
auto seconds_of(const Period & period, int) -> decltype(period.seconds()) {
    return period.seconds();
}
template <typename Period>
double seconds_of(const Period &, long) {
    return NONE;
}

hystmpc_real real_of(double value) { return static_cast<hystmpc_real>(value); }

const char * reason(int answer) {
    switch (answer) {
        case HYSTMPC_BAD_ANGLE: return "the measured angle is no usable number";
        case HYSTMPC_BAD_COMMAND: return "the held command is no number, or beyond the limits of the controller";
        case HYSTMPC_NOT_AT_REST: return "the device does not rest where the model says";
        default: return "unknown";
    }
}

}  // namespace

CallbackReturn HystmpcController::on_init() {
    try {
        auto_declare<std::string>("joint", "");
        auto_declare<std::string>("command_interface", "");
        auto_declare<std::string>("state_interface", "");
        auto_declare<std::string>("angle_unit", "rad");
        auto_declare<double>("command_scale", 1.0);
        auto_declare<double>("start_command", NONE);
        auto_declare<double>("least_angle", NONE);
        auto_declare<double>("greatest_angle", NONE);
        auto_declare<bool>("deactivate_at_once", false);
        controller_ = std::make_unique<hystmpc_controller>();
    } catch (const std::exception & error) {
        return refused(error.what());
    }
    return CallbackReturn::SUCCESS;
}

InterfaceConfiguration HystmpcController::command_interface_configuration() const {
    return {interface_configuration_type::INDIVIDUAL, {command_name_}};
}

InterfaceConfiguration HystmpcController::state_interface_configuration() const {
    return {interface_configuration_type::INDIVIDUAL, {state_name_}};
}

CallbackReturn HystmpcController::on_configure(const rclcpp_lifecycle::State &) {
    const auto node = get_node();
    const auto text = [&node](const char * name) { return node->get_parameter(name).as_string(); };
    joint_ = text("joint");
    command_name_ = text("command_interface");
    state_name_ = text("state_interface");
    if (joint_.empty()) return refused("got no parameter joint, expected the name of the joint that is the tip");
    if (command_name_.empty()) command_name_ = joint_ + "/position";
    if (state_name_.empty()) state_name_ = joint_ + "/position";

    const std::string unit = text("angle_unit");
    if (unit != "rad" && unit != "deg") return refused("got angle_unit " + unit + ", expected rad or deg");
    to_deg_ = unit == "deg" ? 1.0 : 180.0 / 3.14159265358979323846;
    command_scale_ = node->get_parameter("command_scale").as_double();
    if (!std::isfinite(command_scale_) || command_scale_ == 0.0) {
        return refused("got a command_scale of 0 or no number, expected the units of the interface in one mm or bar");
    }
    start_command_ = node->get_parameter("start_command").as_double();
    least_angle_ = node->get_parameter("least_angle").as_double();
    greatest_angle_ = node->get_parameter("greatest_angle").as_double();
    if (least_angle_ >= greatest_angle_) return refused("got a least_angle that is not below greatest_angle");
    deactivate_at_once_ = node->get_parameter("deactivate_at_once").as_bool();

    const double rate = static_cast<double>(get_update_rate());
    if (!(std::abs(rate * HYSTMPC_SAMPLE_S - 1.0) <= SAME_RATE)) {
        return refused(
            "got an update rate of " + std::to_string(rate) + " Hz, expected " + std::to_string(1.0 / HYSTMPC_SAMPLE_S) +
            " Hz: that of the exported controller. Set the parameter update_rate of this controller");
    }

    target_.store(NONE);
    stop_.store(false);
    reference_interfaces_.assign(1, NONE);
    target_subscription_ = node->create_subscription<std_msgs::msg::Float64>(
        "~/target", rclcpp::SystemDefaultsQoS(),
        [this](const std_msgs::msg::Float64 & message) { target_.store(message.data); });
    stop_service_ = node->create_service<std_srvs::srv::Trigger>(
        "~/stop", [this](
                      const std::shared_ptr<std_srvs::srv::Trigger::Request>,
                      std::shared_ptr<std_srvs::srv::Trigger::Response> response) {
            stop_.store(true);
            response->success = true;
            response->message = "the stop is latched from the next update on; deactivate and activate to release it";
        });
    return CallbackReturn::SUCCESS;
}

CallbackReturn HystmpcController::on_activate(const rclcpp_lifecycle::State &) {
    if (command_interfaces_.size() != 1 || state_interfaces_.size() != 1) {
        return refused("expected one command interface " + command_name_ + " and one state interface " + state_name_);
    }
    const double told = told_command(), angle = measured_deg(), held = std::isnan(told) ? start_command_ : told;
    const int answer = hystmpc_init(controller_.get(), real_of(angle), real_of(held));
    if (answer != HYSTMPC_STARTED) {
        return refused(
            std::string("cannot start: ") + reason(answer) + ", got " + std::to_string(angle) + " deg under command " +
            std::to_string(held));
    }
    target_.store(NONE);
    stop_.store(false);
    reference_interfaces_[0] = angle / to_deg_;
    sent_ = held;
    waited_ = NONE;
    return CallbackReturn::SUCCESS;
}

CallbackReturn HystmpcController::on_deactivate(const rclcpp_lifecycle::State &) {
    if (command_interfaces_.size() != 1 || state_interfaces_.size() != 1) return CallbackReturn::SUCCESS;
    hystmpc_stop(controller_.get());
    const double held = held_command();
    if (!admissible(held)) return CallbackReturn::SUCCESS;
    if (!same(held, sent_)) hystmpc_look_on(controller_.get(), real_of(NONE), real_of(held));
    double u = hystmpc_step(controller_.get(), real_of(measured_deg()), nullptr).u;
    for (int k = 0; deactivate_at_once_ && k < MOST_STOP_STEPS; k++) {
        const double next = hystmpc_step(controller_.get(), real_of(NONE), nullptr).u;
        if (next == u) break;
        u = next;
    }
    write(u);
    return CallbackReturn::SUCCESS;
}

CallbackReturn HystmpcController::on_cleanup(const rclcpp_lifecycle::State &) {
    target_subscription_.reset();
    stop_service_.reset();
    return CallbackReturn::SUCCESS;
}

std::vector<hardware_interface::CommandInterface> HystmpcController::on_export_reference_interfaces() {
    std::vector<hardware_interface::CommandInterface> interfaces;
    interfaces.emplace_back(get_node()->get_name(), joint_ + "/position", &reference_interfaces_[0]);
    return interfaces;
}

// Whoever leads next begins with the reference of now.
bool HystmpcController::on_set_chained_mode(bool) {
    target_.store(NONE);
    return true;
}

return_type HystmpcController::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) {
    const double target = target_.load();
    if (std::isfinite(target)) reference_interfaces_[0] = target;
    return return_type::OK;
}

return_type HystmpcController::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration & period) {
    if (stop_.exchange(false)) hystmpc_stop(controller_.get());
    hystmpc_set_target(controller_.get(), real_of(to_deg_ * reference_interfaces_[0]));
    const double held = held_command(), samples = samples_since_the_last(seconds_of(period, 0));
    if (samples < SHORTEST) return return_type::OK;
    waited_ = 0.0;
    if (!admissible(held)) {  // it is not known what the device holds
        sent_ = NONE;
        return return_type::ERROR;
    }
    for (int k = 1; k < MOST_MISSED && k + SHORTEST <= samples; k++) {
        hystmpc_look_on(controller_.get(), real_of(NONE), real_of(held));
    }
    if (samples >= GAP || !same(held, sent_)) {
        hystmpc_look_on(controller_.get(), real_of(measured_deg()), real_of(held));
        sent_ = held;
        return return_type::OK;
    }
    write(hystmpc_step(controller_.get(), real_of(measured_deg()), nullptr).u);
    return return_type::OK;
}

// Samples since the last command, whole ones or not; a first period, and one that is not above zero, are one.
double HystmpcController::samples_since_the_last(double period_s) {
    const double passed = std::isnan(waited_) || !(period_s > 0.0) ? 1.0 : period_s / HYSTMPC_SAMPLE_S;
    waited_ = (std::isnan(waited_) ? 0.0 : waited_) + passed;
    return waited_;
}

CallbackReturn HystmpcController::refused(const std::string & why) const {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", why.c_str());
    return CallbackReturn::ERROR;
}

// The measured angle [deg]; not-a-number beyond what the sensor can say.
double HystmpcController::measured_deg() const {
    const double angle = value_of(state_interfaces_[0], 0);
    return angle < least_angle_ || angle > greatest_angle_ ? NONE : to_deg_ * angle;
}

// What stands at the command interface [mm or bar], where the drive says what it holds; not-a-number where that is none.
// It is on a limit where only the conversion of units took it beyond.
double HystmpcController::told_command() const {
    const double read = value_of(command_interfaces_[0], 0) / command_scale_;
    if (std::isnan(read)) return NONE;
    const double inside = std::clamp(read, HYSTMPC_LOWEST + 0.0, HYSTMPC_HIGHEST + 0.0);
    return same(read, inside) ? inside : read;
}

// The same, or what is known from the activation on where nothing has been written yet.
double HystmpcController::held_command() const {
    const double told = told_command();
    return std::isnan(told) && std::isnan(waited_) ? sent_ : told;
}

bool HystmpcController::same(double one, double other) {
    return std::abs(one - other) <= SAME_COMMAND * (HYSTMPC_HIGHEST - HYSTMPC_LOWEST);
}

bool HystmpcController::admissible(double command) { return HYSTMPC_LOWEST <= command && command <= HYSTMPC_HIGHEST; }

void HystmpcController::write(double command) {
    static_cast<void>(command_interfaces_[0].set_value(command_scale_ * command));
    sent_ = command;
}

}  // namespace hystmpc_control

PLUGINLIB_EXPORT_CLASS(hystmpc_control::HystmpcController, controller_interface::ChainableControllerInterface)
