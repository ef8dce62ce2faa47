"""What an experiment's tables make: the structure of its robot, and the robot's constants."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxmpc.experiment.experiment import Experiment
from jaxmpc.experiment.tables import ArmSettings, TissueSettings, Torques
from jaxmpc.files.errors import InputError
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.law.measurement import Measurement, lowpass_pole
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import Vector
from jaxmpc.law.torque_limits import TorqueLimits
from jaxmpc.world import drive
from jaxmpc.world.arm import TOOL_MASS, link_inertias, tip_at
from jaxmpc.world.friction import Friction
from jaxmpc.world.robot import Cable, Robot, RobotStructure
from jaxmpc.world.sensor import SensorModel
from jaxmpc.world.tissue import Tissue


def structure_of(arm: ArmSettings, tissue: TissueSettings) -> RobotStructure:
    """What of the settings makes a program of its own."""
    cable, tool_inertia = arm.cable_hz > 0.0, arm.beyond_sensor > 0.0
    cancelled = arm.compensation > 0.0, arm.momentum_observer > 0.0
    structure = cable, tool_inertia, arm.integrator, arm.substeps, *cancelled
    return RobotStructure(tissue.kind, tissue.attached, *structure)


def robot_of(experiment: Experiment) -> Robot:
    """The constants of an experiment's world; the stiffness is left open."""
    arm, tissue, sensor, T_s = experiment.arm, experiment.tissue, experiment.sensor, experiment.sampling_time
    posture, path = arm.resting(), experiment.loop_path()
    return Robot(
        measurement=Measurement(T_s, lowpass_pole(path.velocity_cutoff, T_s, FLOATS)),
        drive=drive.Drive(drive.angle_lsb(arm.encoder_counts), arm.torque_lsb),
        limits=TorqueLimits(_most(arm.joint_torque_limit), _most(arm.torque_step_limit), arm.torque_limit),
        friction=Friction(arm.coulomb, arm.presliding),
        viscous=arm.viscous,
        cable=_cable(arm, posture),
        tool_mass=arm.tool_mass - TOOL_MASS,
        sensor=SensorModel(lowpass_pole(path.sensor_cutoff, T_s, FLOATS), sensor.lsb, arm.beyond_sensor),
        tissue=Tissue(0.0, tissue.constants),
        nominal=Nominal(
            1.0 + arm.mass_error,
            # The chain has the usual tool; of what another one weighs as large a share is believed in as of the links.
            (1.0 + arm.mass_error) * (arm.tool_mass - TOOL_MASS) + arm.tool_mass_error,
            NominalFriction(
                tuple(arm.compensation * value for value in arm.nominal_coulomb or arm.coulomb),
                tuple(arm.compensation * value for value in arm.nominal_viscous or arm.viscous),
                arm.nominal_presliding or arm.presliding,
            ),
        ),
        momentum_bandwidth=arm.momentum_observer,
        posture=posture,
        touch=_at_rest(posture).tip,
        extra_delay=float(experiment.delay - 1),
    )


def robot_on_its_tissue(experiment: Experiment) -> Robot:
    """The same with the experiment's stiffness.

    Raises:
        InputError: The experiment has several.
    """
    if len(experiment.stiffness) != 1:
        remedy = "Take one experiment per stiffness."
        raise InputError("stiffness", list(experiment.stiffness), "one stiffness [N/m]", remedy)
    robot = robot_of(experiment)
    return robot._replace(tissue=robot.tissue._replace(stiffness=experiment.stiffness[0]))


def _most(limits: Torques) -> Vector:
    """Limits of the law, in which 0 is none [N m]."""
    return tuple(limit or math.inf for limit in limits)


def _cable(arm: ArmSettings, posture: Vector) -> Cable:
    """Springs whose frequency against a locked motor, link by link in the posture, is `cable_hz`."""
    omega = 2.0 * np.pi * arm.cable_hz
    stiffness = tuple(omega**2 * inertia for inertia in _at_rest(posture).link_inertias)
    damping = tuple(2.0 * arm.cable_damping / max(omega, 1e-9) * each for each in stiffness)
    return Cable(stiffness, damping)


class _AtRest(NamedTuple):
    tip: Vector
    link_inertias: Vector


@lru_cache(maxsize=64)
def _at_rest(posture: Vector) -> _AtRest:
    """What a posture comes to: ten thousand robots of trials share one."""
    return _AtRest(tuple(tip_at(posture).tolist()), tuple(link_inertias(posture).tolist()))
