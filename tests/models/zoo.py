"""The one list of operators and chains that the model tests run over."""

from __future__ import annotations

from dataclasses import replace

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.dynamics import Delay, Lag, LinearDynamics, RateLimit, Servo
from hystmpc.models.operators.friction import (
    Asymmetry,
    DahlDrag,
    DirectionalGain,
    MaxwellSlip,
    RateDependence,
    StickSlip,
)
from hystmpc.models.operators.hysteresis import Backlash, BoucWen, CurvedPlays, InverseBacklash, Play, Stop
from hystmpc.models.operators.measurement import PeriodicDisturbance, Sensor
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.oscillator import Oscillator, StateNetwork
from hystmpc.models.operators.prandtl_ishlinskii import Drdpi, InversePrandtlIshlinskii, PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Creep, Drift, FirstFlexure, TrialShift
from hystmpc.models.operators.static_curves import Contact, Deadband, Line, NonlinearGain, Slack
from hystmpc.models.scheduled import Dependence, MeasuredInput, Scheduled
from hystmpc.models.simulator import Identification, Simulator

DT = 0.04
BACKLASH = Backlash(10.27, 10.70, 2.822, 2.003)  # S2's forward fit in mm and degrees
STATIC_PI = PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.0, 22.0)
RATE_PI = PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, 22.0)
REST_PI = replace(STATIC_PI, speeds=(3.0, 1.0, 0.0))
# Dead at the bottom, saturating at the top: bends at 30 and 40, 60 and 75 deg of 22 to 83 before the dead zones.
DEADBAND = Deadband(1.1, (0.5, 0.08), (0.6, 0.1), (15.0, 10.0), (15.0, 15.0), 50.0, 48.0)
DRDPI = Drdpi(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, -28.0, (0.5, 0.08), (0.6, 0.1), (12.0, 8.0), (12.0, 12.0), 48.0)
CURVED = CurvedPlays((2.0, 3.0, 1.5, 2.0, 2.5, 2.0, 1.0, 1.5, 1.0, 0.5, 3.0, 2.0), 20.0, (0.2, 0.7), 0.5, 5.5, 3)
GRADUAL = CurvedPlays(CURVED.slopes, 20.0, (0.2, 0.7), 0.5, 5.5, 3, turn=1)
REST_CURVED = replace(CURVED, speeds=(3.0, 1.0, 0.0))
REST_GRADUAL = replace(GRADUAL, speeds=(3.0, 1.0, 0.0))
OSCILLATOR = Oscillator(0.01, 0.1, 1.0, 0.5, 0.02, -0.01)
STATE_NETWORK = StateNetwork(
    (0.9, -0.2, 0.3, 0.8),
    (0.2, 0.1, 0.3, -0.1),
    (0.5, 0.4, -0.3, 0.2),
    (0.02, 0.01, -0.01, 0.03),
    (0.01,) * 4,
    (0.1, 0.2),
    2,
    2,
)
BOUC_WEN = BoucWen(-9.0, 0.8, 2.2, 10.7, 10.2, 0.04 / 6, 25.0)
SLIDERS = MaxwellSlip(0.5, (6.0, 3.0, 2.0), 0.15, 0.02, 40.0)
RATE_SLIDERS = MaxwellSlip(-0.5, (6.0, 3.0, 2.0), 0.15, 0.02, 40.0, (0.3, 0.4, 2.0))

# Every operator of the catalogue appears at least once; a test holds this list against the catalogue.
EXAMPLES: tuple[Operator, ...] = (
    Line(10.0, 5.0),
    LinearDynamics((-1.1, 0.3), (0.3, -0.1, 0.0)),
    Play(0.4),
    Stop(0.4),
    SLIDERS,
    RATE_SLIDERS,
    BACKLASH,
    InverseBacklash(10.27, 10.70, 2.822, 2.003, 0.027),
    STATIC_PI,
    RATE_PI,
    REST_PI,
    InversePrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, 22.0),
    DEADBAND,
    DRDPI,
    DRDPI.inverse(),
    BOUC_WEN,
    CURVED,
    GRADUAL,
    REST_CURVED,
    REST_GRADUAL,
    Lag(0.08),
    Delay(0.1, 4),
    Lag(0.08, (0.25,)),
    Lag(0.08, hold=1),
    Lag(0.08, (0.25,), 1),
    Servo(0.12, 0.6),
    Servo(0.12, 0.6, 0),
    RateLimit(2.0),
    RateDependence(0.05, 0.5, 0.1),
    RateDependence(0.05),
    RateDependence(0.05, 0.2, 0.0, -0.4),
    RateDependence(0.08, 0.2, 0.1, -0.4, 0.3),
    RateDependence(0.08, 0.2, 0.1, 0.4, -0.3),
    DahlDrag(0.05, 0.4, 0.7, 0.3),
    Creep((0.3,), (6.0,)),
    Creep((0.2, -0.15), (2.0, 40.0)),
    Drift(0.5, -0.02, 0.003),
    FirstFlexure(0.2, 1.5),
    FirstFlexure(0.3, 1.5, 0.5),
    Slack(0.6),
    Slack(0.6, 0.4),
    DirectionalGain(-0.1, 40.0, 3.0),
    StickSlip(0.3, 4.0),
    Contact(4.0, 0.3),
    Contact(4.0, 0.3, 1.5),
    NonlinearGain(0.03, -0.002, 2.0),
    Asymmetry(1.2, 0.85, 3.0),
    TrialShift(0.4, 1.1, 0.2),
    PeriodicDisturbance(1.1, (0.3, 0.1), (0.2, -1.0)),
    Sensor(0.05, 0.15, 0.03, 2.0, 0.05),
    OSCILLATOR,
    Oscillator(0.01, 0.1, 1.0, 0.5, 0.02, 0.01, hold=1, steps=1),
    STATE_NETWORK,
)
PRESSURE, LOAD = MeasuredInput("pressure_bar", 3.0, 1.0, 7.0), MeasuredInput("load_g", 50.0, 0.0, 100.0)
CHAINS: dict[str, Chain] = {
    "backlash": Chain(BACKLASH),
    "pi": Chain(RATE_PI),
    "delayed pi with lag": Chain(RATE_PI, before=(Delay(0.06, 2),), after=(Lag(0.08),)),
    "pi by two inputs": Chain(
        Scheduled.of(
            RATE_PI,
            (Dependence(PRESSURE, "friction"), Dependence(PRESSURE, "gain", bent=True), Dependence(LOAD, "offset")),
            (0.25, 0.1, -0.05, 0.02),
        ),
        before=(Delay(0.06, 2), Scheduled.of(Lag(0.08), (Dependence(LOAD, "time"),), (0.002,))),
    ),
}
# Not among the chains above: with an effect on the output that shifts the angle a free run does not start where the
# trial does, since the rest of a chain takes the angle behind the core for the one that was seen.
WITH_EFFECTS = Chain(
    BACKLASH, before=(Slack(0.3), Creep((0.3,), (6.0,))), after=(Contact(60.0, 0.3), TrialShift(2.0, 1.1, 0.5))
)


def simulator(chain: Chain, dt: float = DT) -> Simulator:
    """A simulator of a tendon catheter around a chain."""
    return Simulator(
        chain=chain,
        dt_s=dt,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=12.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=20.0, upper=95.0),
        trained_rate_per_s=11.0,
        identification=Identification(method="chosen by hand"),
    )
