from fraclink.lab._arm import ServedArm as ServedArm
from fraclink.lab._arm import SimulatedArm as SimulatedArm
from fraclink.lab._arm import serve_arm as serve_arm
from fraclink.lab._connections import Callback as Callback
from fraclink.lab._connections import Serial as Serial
from fraclink.lab._connections import Udp as Udp
from fraclink.lab._connections import parse_connection as parse_connection
from fraclink.lab._loop import run_realtime as run_realtime
from fraclink.lab._machine import WakeUps as WakeUps
from fraclink.lab._machine import measure_wake_ups as measure_wake_ups
from fraclink.lab._run import RealtimeRun as RealtimeRun
from fraclink.lab._tune import tune as tune
from fraclink.lab._tune_guard import MotionLimits as MotionLimits
from fraclink.lab._tune_moves import FirstMove as FirstMove
from fraclink.lab._tune_wiring import Wiring as Wiring
from fraclink.lab._tuning import Tuning as Tuning
from fraclink.lab._tuning import TuningPlan as TuningPlan
from fraclink.lab._watch import Change as Change
from fraclink.lab._watch import Watch as Watch
from fraclink.lab._watch import watch as watch

__all__: list[str]
