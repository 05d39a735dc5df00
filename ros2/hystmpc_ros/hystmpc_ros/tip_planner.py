"""The node `tip_planner`: `hystmpc.TipController` behind topics and services, at a device behind two topics."""

from __future__ import annotations

import math
import signal
import time
from typing import Any, final

import rclpy
import rclpy.logging
from builtin_interfaces.msg import Time
from hystmpc_msgs.msg import TipState
from hystmpc_msgs.srv import SetReference, SetTarget
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from hystmpc.ctrl import TipController
from hystmpc.ctrl.config import sensor_fault
from hystmpc.ctrl.planner.settings import read_settings
from hystmpc.rig.safety.intake import SensorSettings
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.topics import TopicTransport, stamp
from hystmpc.rig.transports.transport import Conversion
from hystmpc.trials.errors import ConfigError, HystmpcError

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
    "start_command": math.nan,  # what the device holds, where it does not tell
}


@final
class TipPlanner(Node):
    """Steps a controller at its sample time.

    Raises:
        HystmpcError: if a parameter or the controller's file cannot be used; one line.
    """

    def __init__(self) -> None:
        super().__init__("tip_planner")
        given = {name: self.declare_parameter(name, value).value for name, value in PARAMETERS.items()}
        if not given["config"]:
            raise ConfigError("got no parameter config, expected the file of a controller, such as tip.yaml")
        settings, _ = read_settings(given["config"])
        if fault := sensor_fault(settings.controller, "continuous"):
            raise ConfigError(f"{given['config']}: controller.{fault}")
        sensor = ("lower_deg", "upper_deg", "rate_limit_deg_s", "age_limit_s", "dead_after_s")
        topics = {name: given[name] for name in ("angle_topic", "command_topic", "message")}
        qos = {name: given[name] for name in ("reliability", "depth")}
        wire = RosWire(self, DdsSettings.parse({"kind": "dds", **topics, "qos": qos}, "parameters"))
        tip, safe = TipController.from_config(given["config"]), settings.controller.resolved().ladder.safe_command
        self.planner = Planner(
            tip,
            TopicTransport(wire, Conversion(1.0, 0.0, 1.0)),
            SensorSettings.parse({name: given[name] for name in sensor}, "parameters"),
            float(given["start_command"]),
            math.nan if safe is None else safe,
            time.monotonic_ns,
        )
        self._said = ""
        self._states = self.create_publisher(TipState, "~/state", 10)
        self.create_subscription(Float64, "~/target", self._target, 10)
        self.create_service(SetTarget, "~/set_target", self._set_target)
        self.create_service(SetReference, "~/set_reference", self._set_reference)
        self.create_service(Trigger, "~/stop", self._stop)
        self.create_service(Trigger, "~/reset", self._reset)
        self._timer = self.create_timer(tip.dt, self.sample)

    def sample(self) -> None:
        """One sample, and what it led to."""
        self.planner.sample()
        self._states.publish(self._state())
        if self.planner.status != self._said:
            self._said = self.planner.status
            self.get_logger().info(self._said)

    def retire(self) -> None:
        """Go to the safe command, for ten seconds at most, and leave."""
        self.planner.tip.stop()
        end = time.monotonic() + _END_S
        while not self.planner.at_rest and time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=self.planner.tip.dt)
        self.planner.close()

    def _state(self) -> TipState:
        state, message = self.planner.tip.state(), TipState()
        sec, nanosec = stamp(time.time_ns())
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        message.measured_deg, message.reference_deg = state.measured_deg, state.reference_deg
        message.error_deg = state.reference_deg - state.measured_deg
        message.departure_deg, message.command = state.disturbance_deg, state.command
        message.source, message.status = str(state.source), self.planner.status
        message.settled, message.stopped = state.settled, state.stopped
        return message

    def _target(self, message: Float64) -> None:
        try:
            self.planner.tip.set_target(message.data)
        except HystmpcError as error:
            self.get_logger().warning(f"target {message.data}: {error}")

    def _set_target(self, request: SetTarget.Request, response: SetTarget.Response) -> SetTarget.Response:
        try:
            reach = self.planner.tip.set_target(request.angle_deg)
        except HystmpcError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message, response.reachable = True, reach.reason, reach.reachable
        response.low_deg, response.high_deg = reach.low_deg, reach.high_deg
        return response

    def _set_reference(self, request: SetReference.Request, response: SetReference.Response) -> SetReference.Response:
        try:
            self.planner.tip.set_reference(list(request.angles_deg))
        except HystmpcError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"{len(request.angles_deg)} samples"
        return response

    def _stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.planner.tip.stop()
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
