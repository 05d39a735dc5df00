"""The node `tip_planner`: `hystmpc.TipController` behind topics and services, at a device behind two topics."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Mapping
from typing import Any, final

import rclpy
import rclpy.logging
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from hystmpc.rig.axes import each, in_words, is_known, together
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.experiment import Steering
from hystmpc.rig.plane_config import PlaneBenchSettings
from hystmpc.rig.realtime import Clock, MonotonicClock
from hystmpc.rig.transports.topics import TopicSettings, TopicTransport, numbers, stamp
from hystmpc.rig.transports.transport import Conversion
from hystmpc.trials.errors import ConfigError, HystmpcError

from .faces import face, less, seen
from .planner import Planner
from .wire import RosWire

_END_S = 10.0  # longest way to the safe command at the node's end

PARAMETERS: dict[str, Any] = {
    "config": "",  # tip.yaml
    "angle_topic": "tip/angle_deg",
    "command_topic": "tip/command",
    "message": "float64_stamped",
    "reliability": "reliable",
    "depth": 10,
    "lower_deg": 0.0,  # plausible angles
    "upper_deg": 180.0,
    "rate_limit_deg_s": 500.0,
    "age_limit_s": 0.1,
    "dead_after_s": 0.5,
    "frozen_samples": 10,
    "frozen_travel": 0.3,
    "held_tolerance": 0.1,
    "start_command": math.nan,  # what the device holds, where it does not tell; not a number: it tells
    "travel": math.nan,  # plausibility; not a number: from the limits and the range of the sensor
    "moves_deg": math.nan,
    "travel_s": 0.5,
    "model_error_deg": 20.0,
    "model_error_s": 1.0,
    "watch_motion": True,
    "watch_direction": True,
    "watch_model": True,
    "velocity_per_s": 2.0,  # ramps: the way to the safe command
    "acceleration_per_s2": 10.0,
    "jerk_per_s3": 100.0,
    "brake_per_s2": math.nan,
    "stop_overshoot": math.nan,
}
OF_TWO_AXES: dict[str, Any] = {"lower_deg": -180.0, "start_command": [math.nan, math.nan]}
"""Defaults of a controller of two axes, where they differ."""
_BLOCKS = {
    "sensor": (
        ("lower_deg", "upper_deg", "rate_limit_deg_s", "age_limit_s", "dead_after_s")
        + ("frozen_samples", "frozen_travel", "held_tolerance")
    ),
    "plausibility": (
        ("travel", "moves_deg", "travel_s", "model_error_deg", "model_error_s")
        + ("watch_motion", "watch_direction", "watch_model")
    ),
    "ramps": ("velocity_per_s", "acceleration_per_s2", "jerk_per_s3", "brake_per_s2"),
    "transport": ("angle_topic", "command_topic", "message"),
}


def bench(given: Mapping[str, Any], steering: Steering) -> BenchSettings:
    """The parameters as the bench of a run.

    Raises:
        ConfigError: if they make no sense.
    """
    known = {name: _known(value) for name, value in given.items()}
    blocks: dict[str, dict[str, Any]] = {
        block: {name: known[name] for name in names} for block, names in _BLOCKS.items()
    }
    blocks["transport"] |= {"kind": "dds", "qos": {name: known[name] for name in ("reliability", "depth")}}
    limits, safe = each(steering.limits), steering.safe_command
    lower, upper, rate = (together(getattr(one, end) for one in limits) for end in ("lower", "upper", "rate"))
    kind = BenchSettings if steering.frame is None else PlaneBenchSettings
    return kind.parse(
        {
            "name": "tip_planner",
            "rate_hz": 1.0 / steering.tip.dt,
            "command_unit": steering.unit,
            "limits": {"lower": lower, "upper": upper, "rate_per_s": rate},
            "safe_command": safe if is_known(safe) else lower,  # the planner knows that there is none
            "start_command": known["start_command"],
            "stop_overshoot": known["stop_overshoot"],
            **blocks,
        },
        "parameters",
    )


def _known(value: Any) -> Any:
    """A parameter; None where it is not a number, or of two axes none."""
    if isinstance(value, str | bool | int | float):
        return None if value != value else value
    return None if any(one != one for one in value) else list(value)  # an array of ROS


@final
class TipPlanner(Node):
    """Takes the samples of a run at the controller's sample time; of one axis, or of two where the model has two.

    Raises:
        HystmpcError: if a parameter or the controller's file cannot be used; one line.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__("tip_planner")
        clock = clock or MonotonicClock()
        config = self.declare_parameter("config", PARAMETERS["config"]).value
        if not config:
            raise ConfigError("got no parameter config, expected the file of a controller, such as tip.yaml")
        steering = Steering(config)
        axes = len(each(steering.limits))
        defaults = PARAMETERS if axes == 1 else PARAMETERS | OF_TWO_AXES
        given = {
            name: config if name == "config" else self.declare_parameter(name, value).value
            for name, value in defaults.items()
        }
        settings = bench(given, steering)
        assert isinstance(settings.transport, TopicSettings)
        wire = RosWire(self, settings.transport, clock.now_ns, axes)
        conversion = Conversion(together([1.0] * axes), together([0.0] * axes), 1.0)
        transport = TopicTransport(wire, conversion, clock.now_ns)
        self.planner = Planner(settings, steering, transport, clock)
        tip, self._face = steering.tip, face(axes)
        self._said = ""
        self._states = self.create_publisher(self._face.state, "~/state", 10)
        self.create_subscription(self._face.target, "~/target", self._target, 10)
        self.create_service(self._face.set_target, "~/set_target", self._set_target)
        self.create_service(self._face.set_reference, "~/set_reference", self._set_reference)
        self.create_service(Trigger, "~/stop", self._stop)
        self.create_service(Trigger, "~/reset", self._reset)
        self._timer = self.create_timer(tip.dt, self.sample)

    def sample(self) -> None:
        """One sample, with its messages."""
        self.planner.sample()
        self._states.publish(self._state())
        if self.planner.status != self._said:
            self._said = self.planner.status
            self.get_logger().info(self._said)

    def retire(self) -> None:
        """Go to the safe command, for ten seconds at most, and leave."""
        self.planner.leave("the node ends")
        end = time.monotonic() + _END_S
        while not self.planner.over and time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=self.planner.tip.dt)
        self.planner.close()

    def _state(self) -> Any:
        state, sample, message = self.planner.tip.state(), self.planner.newest, self._face.state()
        sec, nanosec = stamp(time.time_ns())
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        measured, command, source = state.measured_deg, state.command, state.source
        if sample is not None:  # what has left, which on the way to the safe command is not the controller's
            command, source, measured = sample.command, sample.source, seen(sample.measured_deg, measured)
        number = self._face.numbers
        message.measured_deg, message.reference_deg = number(measured), number(state.reference_deg)
        message.error_deg = number(less(state.reference_deg, measured))
        message.command, message.source = number(command), str(source)
        message.departure_deg, message.status = number(state.disturbance_deg), self.planner.status
        message.settled, message.stopped = state.settled, state.stopped
        return message

    def _target(self, message: Any) -> None:
        target = numbers(message.data)
        try:
            self.planner.tip.set_target(target)
        except HystmpcError as error:
            self.get_logger().warning(f"target {in_words(target)}: {error}")

    def _set_target(self, request: Any, response: Any) -> Any:
        try:
            reach = self.planner.tip.set_target(numbers(request.angle_deg))
        except HystmpcError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message, response.reachable = True, reach.reason, bool(reach)
        self._face.answer(response, reach)
        return response

    def _set_reference(self, request: Any, response: Any) -> Any:
        try:
            wanted = self._face.reference(request)
            self.planner.tip.set_reference(wanted)
        except HystmpcError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"{len(wanted)} samples"
        return response

    def _stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.planner.stop("the service stop")
        response.success, response.message = True, "the stop is latched; the service reset releases it"
        return response

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.planner.reset()
        response.success, response.message = True, "waits for the device"
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node; Ctrl-C and SIGTERM lead to the safe command first."""
    # rclpy's own handlers would take the topics away before the safe command is sent.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        node = TipPlanner()
    except HystmpcError as error:
        rclpy.logging.get_logger("tip_planner").error(str(error))
        rclpy.try_shutdown()
        return 2
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        for one in (signal.SIGINT, signal.SIGTERM):  # a second one must not break off the way to the safe command
            signal.signal(one, signal.SIG_IGN)
        node.retire()
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
