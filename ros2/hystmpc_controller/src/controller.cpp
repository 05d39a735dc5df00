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
static_assert(std::atomic<unsigned>::is_always_lock_free, "an update must not wait");

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

// An array with the same value in each place.
template <typename Values>
Values all_of(double value) {
    Values values;
    values.fill(value);
    return values;
}

const Angles NO_ANGLES = all_of<Angles>(NONE);

// Numbers for a message: `1.5`, or `1.5, -2.0`.
template <typename Values>
std::string listed(const Values & values) {
    std::string text;
    for (const double value : values) text += (text.empty() ? "" : ", ") + std::to_string(value);
    return text;
}

std::string listed(const std::vector<std::string> & names) {
    std::string text;
    for (const auto & name : names) text += (text.empty() ? "" : ", ") + name;
    return text;
}

#ifdef HYSTMPC_AXES
using Texts = std::vector<std::string>;
using Numbers = std::vector<double>;
#endif

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
#ifdef HYSTMPC_AXES
        auto_declare<Texts>("joints", {});
        auto_declare<Texts>("command_interfaces", {});
        auto_declare<Texts>("state_interfaces", {});
        auto_declare<Numbers>("start_commands", {});
#else
        auto_declare<std::string>("joint", "");
        auto_declare<std::string>("command_interface", "");
        auto_declare<std::string>("state_interface", "");
        auto_declare<double>("start_command", NONE);
#endif
        auto_declare<std::string>("angle_unit", "rad");
        auto_declare<double>("command_scale", 1.0);
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
    return {interface_configuration_type::INDIVIDUAL, command_names_};
}

InterfaceConfiguration HystmpcController::state_interface_configuration() const {
    return {interface_configuration_type::INDIVIDUAL, state_names_};
}

CallbackReturn HystmpcController::on_configure(const rclcpp_lifecycle::State &) {
    const auto node = get_node();
    if (const std::string why = read_names(); !why.empty()) return refused(why);

    const std::string unit = node->get_parameter("angle_unit").as_string();
    if (unit != "rad" && unit != "deg") return refused("got angle_unit " + unit + ", expected rad or deg");
    to_deg_ = unit == "deg" ? 1.0 : 180.0 / 3.14159265358979323846;
    command_scale_ = node->get_parameter("command_scale").as_double();
    if (!std::isfinite(command_scale_) || command_scale_ == 0.0) {
        return refused("got a command_scale of 0 or no number, expected the units of the interface in one mm or bar");
    }
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

    put_target(NO_ANGLES);
    stop_.store(false);
    reference_interfaces_.assign(AXES, NONE);
    target_subscription_ = node->create_subscription<Target>(
        "~/target", rclcpp::SystemDefaultsQoS(), [this](const Target & message) {
#ifdef HYSTMPC_AXES
            if (message.data.size() != AXES) {
                refused("got " + std::to_string(message.data.size()) + " angles on ~/target, expected x and y");
                return;
            }
            put_target({message.data[0], message.data[1]});
#else
            put_target({message.data});
#endif
        });
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

// The names of the interfaces, and what the drive holds where it does not say; why they make no sense, or nothing.
std::string HystmpcController::read_names() {
    const auto node = get_node();
#ifdef HYSTMPC_AXES
    const auto texts = [&node](const char * name) { return node->get_parameter(name).as_string_array(); };
    joints_ = texts("joints");
    command_names_ = texts("command_interfaces");
    state_names_ = texts("state_interfaces");
    const Numbers starts = node->get_parameter("start_commands").as_double_array();
    if (joints_.size() != AXES) {
        return "got " + std::to_string(joints_.size()) + " names in the parameter joints, expected those of x and y";
    }
    for (const std::string & joint : joints_) {
        if (texts("state_interfaces").empty()) state_names_.push_back(joint + "/position");
        if (COMMANDS == AXES && texts("command_interfaces").empty()) command_names_.push_back(joint + "/position");
    }
    if (state_names_.size() != AXES || command_names_.size() != COMMANDS) {
        return "got " + std::to_string(state_names_.size()) + " state_interfaces and " +
               std::to_string(command_names_.size()) + " command_interfaces, expected " + std::to_string(AXES) + " and " +
               std::to_string(COMMANDS);
    }
    if (!starts.empty() && starts.size() != COMMANDS) {
        return "got " + std::to_string(starts.size()) + " start_commands, expected " + std::to_string(COMMANDS);
    }
    start_command_ = all_of<Commands>(NONE);
    std::copy(starts.begin(), starts.end(), start_command_.begin());
#else
    const auto text = [&node](const char * name) { return node->get_parameter(name).as_string(); };
    joints_ = {text("joint")};
    command_names_ = {text("command_interface")};
    state_names_ = {text("state_interface")};
    if (joints_[0].empty()) return "got no parameter joint, expected the name of the joint that is the tip";
    if (command_names_[0].empty()) command_names_[0] = joints_[0] + "/position";
    if (state_names_[0].empty()) state_names_[0] = joints_[0] + "/position";
    start_command_ = {node->get_parameter("start_command").as_double()};
#endif
    return "";
}

// Whether every interface has been given to this controller.
bool HystmpcController::claimed() const {
    return command_interfaces_.size() == COMMANDS && state_interfaces_.size() == AXES;
}

CallbackReturn HystmpcController::on_activate(const rclcpp_lifecycle::State &) {
    if (!claimed()) {
        return refused(
            "expected the command interfaces " + listed(command_names_) + " and the state interfaces " +
            listed(state_names_));
    }
    const Commands told = told_command();
    Commands held = told;
    for (std::size_t k = 0; k < COMMANDS; k++) held[k] = std::isnan(told[k]) ? start_command_[k] : told[k];
    const Angles angles = measured_deg();
    const int answer = engine::init(controller_.get(), angles, held);
    if (answer != HYSTMPC_STARTED) {
        return refused(
            std::string("cannot start: ") + reason(answer) + ", got " + listed(angles) + " deg under command " +
            listed(held));
    }
    put_target(NO_ANGLES);
    stop_.store(false);
    for (std::size_t i = 0; i < AXES; i++) reference_interfaces_[i] = angles[i] / to_deg_;
    sent_ = held;
    waited_ = NONE;
    return CallbackReturn::SUCCESS;
}

CallbackReturn HystmpcController::on_deactivate(const rclcpp_lifecycle::State &) {
    if (!claimed()) return CallbackReturn::SUCCESS;
    hystmpc_stop(controller_.get());
    const Commands held = held_command();
    if (!admissible(held)) return CallbackReturn::SUCCESS;
    if (!same(held, sent_)) engine::look_on(controller_.get(), NO_ANGLES, held);
    Commands u = engine::step(controller_.get(), measured_deg());
    for (int k = 0; deactivate_at_once_ && k < MOST_STOP_STEPS; k++) {
        const Commands next = engine::step(controller_.get(), NO_ANGLES);
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
    for (std::size_t i = 0; i < AXES; i++) {
        interfaces.emplace_back(get_node()->get_name(), joints_[i] + "/position", &reference_interfaces_[i]);
    }
    return interfaces;
}

// Whoever leads next begins with the reference of now.
bool HystmpcController::on_set_chained_mode(bool) {
    put_target(NO_ANGLES);
    return true;
}

// A message for the next update; the count is odd meanwhile, so that no update takes one half of it.
void HystmpcController::put_target(const Angles & angles) {
    target_count_.fetch_add(1);
    for (std::size_t i = 0; i < AXES; i++) target_[i].store(angles[i]);
    target_count_.fetch_add(1);
}

return_type HystmpcController::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) {
    const unsigned count = target_count_.load();
    Angles target;
    bool finite = true;
    for (std::size_t i = 0; i < AXES; i++) {
        target[i] = target_[i].load();
        finite = finite && std::isfinite(target[i]);
    }
    if (!finite || count % 2 != 0 || count != target_count_.load()) return return_type::OK;  // the next update takes it
    std::copy(target.begin(), target.end(), reference_interfaces_.begin());
    return return_type::OK;
}

return_type HystmpcController::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration & period) {
    if (stop_.exchange(false)) hystmpc_stop(controller_.get());
    Angles wanted;
    for (std::size_t i = 0; i < AXES; i++) wanted[i] = to_deg_ * reference_interfaces_[i];
    engine::set_target(controller_.get(), wanted);
    const Commands held = held_command();
    const double samples = samples_since_the_last(seconds_of(period, 0));
    if (samples < SHORTEST) return return_type::OK;
    waited_ = 0.0;
    if (!admissible(held)) {  // it is not known what the device holds
        sent_ = all_of<Commands>(NONE);
        return return_type::ERROR;
    }
    for (int k = 1; k < MOST_MISSED && k + SHORTEST <= samples; k++) {
        engine::look_on(controller_.get(), NO_ANGLES, held);
    }
    if (samples >= GAP || !same(held, sent_)) {
        engine::look_on(controller_.get(), measured_deg(), held);
        sent_ = held;
        return return_type::OK;
    }
    write(engine::step(controller_.get(), measured_deg()));
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

// The measured angles [deg]; not-a-number beyond what the sensor can say.
Angles HystmpcController::measured_deg() const {
    Angles angles;
    for (std::size_t i = 0; i < AXES; i++) {
        const double angle = value_of(state_interfaces_[i], 0);
        angles[i] = angle < least_angle_ || angle > greatest_angle_ ? NONE : to_deg_ * angle;
    }
    return angles;
}

// What stands at the command interfaces [mm or bar], where a drive says what it holds; not-a-number where that is none.
// It is on a limit where only the conversion of units took it beyond.
Commands HystmpcController::told_command() const {
    Commands told;
    for (std::size_t k = 0; k < COMMANDS; k++) {
        const double read = value_of(command_interfaces_[k], 0) / command_scale_;
        const double inside = std::clamp(read, LOWEST[k], HIGHEST[k]);
        told[k] = std::abs(read - inside) <= SAME_COMMAND * (HIGHEST[k] - LOWEST[k]) ? inside : read;
    }
    return told;
}

// The same, or what is known from the activation on where nothing has been written yet.
Commands HystmpcController::held_command() const {
    Commands held = told_command();
    for (std::size_t k = 0; k < COMMANDS; k++) {
        if (std::isnan(held[k]) && std::isnan(waited_)) held[k] = sent_[k];
    }
    return held;
}

bool HystmpcController::same(const Commands & one, const Commands & other) {
    for (std::size_t k = 0; k < COMMANDS; k++) {
        if (!(std::abs(one[k] - other[k]) <= SAME_COMMAND * (HIGHEST[k] - LOWEST[k]))) return false;
    }
    return true;
}

bool HystmpcController::admissible(const Commands & commands) {
    for (std::size_t k = 0; k < COMMANDS; k++) {
        if (!(LOWEST[k] <= commands[k] && commands[k] <= HIGHEST[k])) return false;
    }
    return true;
}

void HystmpcController::write(const Commands & commands) {
    for (std::size_t k = 0; k < COMMANDS; k++) {
        static_cast<void>(command_interfaces_[k].set_value(command_scale_ * commands[k]));
    }
    sent_ = commands;
}

}  // namespace hystmpc_control

PLUGINLIB_EXPORT_CLASS(hystmpc_control::HystmpcController, controller_interface::ChainableControllerInterface)
