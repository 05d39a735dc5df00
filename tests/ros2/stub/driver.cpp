// What a controller manager does, one call each, for ctypes; and a count of the memory that is taken meanwhile.
#include <cstdlib>
#include <iterator>
#include <limits>
#include <memory>
#include <new>
#include <sstream>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"

using Controller = controller_interface::ChainableControllerInterface;
using controller_interface::CallbackReturn;

static long taken = 0;

void * operator new(std::size_t size) {
    taken++;
    if (void * place = std::malloc(size)) return place;
    throw std::bad_alloc();
}
void operator delete(void * place) noexcept { std::free(place); }
void operator delete(void * place, std::size_t) noexcept { std::free(place); }

std::unique_ptr<Controller> plugin_made();

namespace {

struct Manager {
    std::unique_ptr<Controller> controller = plugin_made();
    std::vector<double> commands = std::vector<double>(6, std::numeric_limits<double>::quiet_NaN()), angles = commands;
    std::vector<hardware_interface::CommandInterface> references;
    std::string names;
};

std::string prefix(const std::string & name) { return name.substr(0, name.rfind('/')); }
std::string last(const std::string & name) { return name.substr(name.rfind('/') + 1); }
int code(CallbackReturn answer) { return static_cast<int>(answer); }

}  // namespace

extern "C" {

Manager * manager_new(unsigned int update_rate) {
    auto manager = std::make_unique<Manager>();
    return manager->controller->init("tip_controller", update_rate) == CallbackReturn::SUCCESS ? manager.release()
                                                                                               : nullptr;
}
void manager_delete(Manager * m) { delete m; }

void set_text(Manager * m, const char * name, const char * value) {
    m->controller->get_node()->parameters.at(name) = std::string(value);
}
void set_number(Manager * m, const char * name, double value) { m->controller->get_node()->parameters.at(name) = value; }
// Parameters that are lists: names apart by spaces, and so many numbers.
void set_texts(Manager * m, const char * name, const char * values) {
    std::istringstream words(values);
    m->controller->get_node()->parameters.at(name) =
        std::vector<std::string>{std::istream_iterator<std::string>(words), {}};
}
void set_numbers(Manager * m, const char * name, const double * values, int count) {
    m->controller->get_node()->parameters.at(name) = std::vector<double>(values, values + count);
}
void set_flag(Manager * m, const char * name, int value) { m->controller->get_node()->parameters.at(name) = value != 0; }
const char * said(Manager * m) { return m->controller->get_node()->said.c_str(); }

int configure(Manager * m) {
    const int answer = code(m->controller->on_configure({}));
    if (answer == 0) m->references = m->controller->export_reference_interfaces();
    return answer;
}
// Claims what the controller asks for: each name has its value in the order of the names.
int activate(Manager * m) {
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    std::vector<hardware_interface::LoanedStateInterface> states;
    m->names.clear();
    for (const auto & name : m->controller->command_interface_configuration().names) {
        commands.emplace_back(prefix(name), last(name), &m->commands.at(commands.size()));
        m->names += name + " ";
    }
    for (const auto & name : m->controller->state_interface_configuration().names) {
        states.emplace_back(prefix(name), last(name), &m->angles.at(states.size()));
        m->names += name + " ";
    }
    for (const auto & reference : m->references) m->names += reference.get_name() + " ";
    m->controller->assign_interfaces(std::move(commands), std::move(states));
    const int answer = code(m->controller->on_activate({}));
    if (answer != 0) m->controller->release_interfaces();
    return answer;
}
int deactivate(Manager * m) {
    const int answer = code(m->controller->on_deactivate({}));
    m->controller->release_interfaces();
    return answer;
}
int cleanup(Manager * m) { return code(m->controller->on_cleanup({})); }
const char * names(Manager * m) { return m->names.c_str(); }

void hold_at(Manager * m, int k, double command) { m->commands.at(k) = command; }
double held_at(Manager * m, int k) { return m->commands.at(k); }
void measure_at(Manager * m, int i, double angle) { m->angles.at(i) = angle; }
void refer_at(Manager * m, int i, double angle) { static_cast<void>(m->references.at(i).set_value(angle)); }
void hold(Manager * m, double command) { hold_at(m, 0, command); }
double held(Manager * m) { return held_at(m, 0); }
void measure(Manager * m, double angle) { measure_at(m, 0, angle); }
int chain(Manager * m, int chained) { return m->controller->set_chained_mode(chained != 0); }
void refer(Manager * m, double angle) { refer_at(m, 0, angle); }

// One period; how often memory was taken in it, or -1 where the update failed.
long update_after(Manager * m, double period_s) {
    const long before = taken;
    const auto answer = m->controller->update({}, {period_s});
    return answer == controller_interface::return_type::OK ? taken - before : -1;
}
long update(Manager * m) { return update_after(m, 1.0 / m->controller->get_update_rate()); }

int target(Manager * m, double angle) {
    const auto subscription = m->controller->get_node()->target.lock();
    if (!subscription) return 0;
    std_msgs::msg::Float64 message;
    message.data = angle;
    subscription->callback(message);
    return 1;
}
int targets(Manager * m, const double * angles, int count) {
    const auto subscription = m->controller->get_node()->targets.lock();
    if (!subscription) return 0;
    std_msgs::msg::Float64MultiArray message;
    message.data.assign(angles, angles + count);
    subscription->callback(message);
    return 1;
}
int stop(Manager * m) {
    const auto service = m->controller->get_node()->stop.lock();
    if (!service) return 0;
    auto response = std::make_shared<std_srvs::srv::Trigger::Response>();
    service->callback(std::make_shared<std_srvs::srv::Trigger::Request>(), response);
    return response->success;
}

}  // extern "C"
