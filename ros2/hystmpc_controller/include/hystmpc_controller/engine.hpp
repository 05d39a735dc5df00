// The functions of the exported C on arrays, of one axis and of two: hystmpc.h has HYSTMPC_AXES for two axes only.
#ifndef HYSTMPC_CONTROLLER__ENGINE_HPP_
#define HYSTMPC_CONTROLLER__ENGINE_HPP_

#include <array>
#include <cstddef>

#include "hystmpc.h"

namespace hystmpc_control {

#ifdef HYSTMPC_AXES
constexpr std::size_t AXES = HYSTMPC_AXES, COMMANDS = HYSTMPC_COMMANDS;
constexpr double LOWEST[] = HYSTMPC_LOWEST, HIGHEST[] = HYSTMPC_HIGHEST;  // [mm or bar]
#else
constexpr std::size_t AXES = 1, COMMANDS = 1;
constexpr double LOWEST[] = {HYSTMPC_LOWEST + 0.0}, HIGHEST[] = {HYSTMPC_HIGHEST + 0.0};
#endif

using Angles = std::array<double, AXES>;        // [deg]
using Commands = std::array<double, COMMANDS>;  // [mm or bar]

namespace engine {

#ifdef HYSTMPC_AXES
// An array of the engine's numbers, for the length of a call.
template <std::size_t N>
struct Reals {
    explicit Reals(const std::array<double, N> & values) {
        for (std::size_t k = 0; k < N; k++) numbers[k] = static_cast<hystmpc_real>(values[k]);
    }
    operator const hystmpc_real *() const { return numbers; }
    hystmpc_real numbers[N];
};
template <std::size_t N>
Reals<N> reals(const std::array<double, N> & values) { return Reals<N>(values); }
#else
inline hystmpc_real reals(const std::array<double, 1> & values) { return static_cast<hystmpc_real>(values[0]); }
#endif

inline int init(hystmpc_controller * c, const Angles & angles, const Commands & held) {
    return hystmpc_init(c, reals(angles), reals(held));
}

inline void set_target(hystmpc_controller * c, const Angles & angles) { hystmpc_set_target(c, reals(angles)); }

inline void look_on(hystmpc_controller * c, const Angles & angles, const Commands & held) {
    hystmpc_look_on(c, reals(angles), reals(held));
}

inline Commands step(hystmpc_controller * c, const Angles & angles) {
    const hystmpc_command next = hystmpc_step(c, reals(angles), nullptr);
#ifdef HYSTMPC_AXES
    Commands commands;
    for (std::size_t k = 0; k < COMMANDS; k++) commands[k] = next.u[k];
    return commands;
#else
    return {next.u};
#endif
}

}  // namespace engine

}  // namespace hystmpc_control

#endif  // HYSTMPC_CONTROLLER__ENGINE_HPP_
