// A closed loop in C++ around an exported controller and a simple simulated device.
//
//   hystmpc export-c examples/tip.yaml --out c
//   cc -std=c99 -O2 -c c/hystmpc.c -o hystmpc.o
//   c++ -std=c++11 -O2 -I c examples/exported_c/loop.cpp hystmpc.o -o loop && ./loop
#include "hystmpc.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>

namespace {

// A backlash of 0.3 mm half-width and 10.5 deg/mm behind a lag of 80 ms.
class Device {
public:
    double apply(double u) {
        travel_ += (1.0 - std::exp(-HYSTMPC_SAMPLE_S / 0.08)) * (u - travel_);
        play_ = std::max(travel_ - 0.3, std::min(travel_ + 0.3, play_));
        return 25.0 + 10.5 * play_;
    }

private:
    double travel_ = 2.0, play_ = 2.0;
};

} // namespace

int main() {
    std::unique_ptr<hystmpc_controller> controller(new hystmpc_controller());
    Device device;
    double angle = device.apply(2.0);
    if (hystmpc_init(controller.get(), angle, 2.0) != HYSTMPC_STARTED) {
        std::puts("the device does not rest where the model says");
        return 1;
    }
    const double targets[] = {60.0, 45.0, 70.0};
    for (double target : targets) {
        hystmpc_set_target(controller.get(), target);
        for (int k = 0; k < 100; ++k) {
            angle = device.apply(hystmpc_step(controller.get(), angle, nullptr).u);
        }
        std::printf("target %.1f deg, reached %.2f deg\n", target, angle);
    }
    return 0;
}
