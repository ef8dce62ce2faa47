"""The twin's arm and heart against the simulator's, and what only the twin has: contact that comes and goes."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.twin.contact import TwinContact
from deploy.twin.heart import TwinHeart
from deploy.twin.scenario import HEARTS, RHYTHMS, SCENARIOS, motion_named, twin_settings, unlike_the_simulation
from deploy.twin.settings import HOME, TwinSettings
from deploy.twin.world import TORQUE_CONSTANT, WINDING, TwinPhysics
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.experiment.tables import TissueSettings
from jaxmpc.files.errors import InputError
from jaxmpc.law.chain import inverse_dynamics, pose, tip
from jaxmpc.law.scalar import apply_transposed
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.world import robot
from jaxmpc.world.arm import chain, joint_ranges, tip_at
from jaxmpc.world.heart.motion import Motion, displacement
from jaxmpc.world.joint_acceleration import accelerate
from jaxmpc.world.tissue import KINDS

pytestmark = pytest.mark.once

FLOATS = SimpleNamespace(
    sin=math.sin,
    cos=math.cos,
    exp=math.exp,
    sqrt=math.sqrt,
    floor=math.floor,
    maximum=max,
    near=lambda angle, other: angle,
    where=lambda condition, this, that: this if condition else that,
)
NONE = (0.0, 0.0, 0.0, 0.0)
DRIVING, IDLE = (False,) * 4, (True,) * 4
FREE = {"coulomb": NONE, "viscous": NONE}


def holding(world, lift=0.0):
    """Motor torques that hold the arm against gravity and lift the tip by a force [N]."""
    at = pose(chain(), world.q, math)
    held = np.array(inverse_dynamics(chain(), at, NONE, NONE))
    held += np.array(tip(chain(), at).jacobian)[2] * lift
    return apply_transposed(MOTOR_TO_JOINT, tuple(held.tolist()))


def run(world, seconds, lift=0.0, braked=DRIVING):
    truths = []
    for _ in range(round(1e3 * seconds)):
        world.advance(holding(world, lift), braked)
        truths.append(world.truth())
    return truths


def assert_new(truth, settings):
    """A tip that has just touched has no more sideways force than its way in one millisecond makes."""
    assert truth.touching
    assert np.abs(truth.force[:2]).max() <= settings.stiffness * np.linalg.norm(truth.tip_velocity) * 1e-3


@pytest.mark.parametrize(("kind", "steps"), [(kind, 1000 if kind == "elastic" else 300) for kind in KINDS])
def test_the_world_is_the_simulators(kind, steps):
    """Under the same torques, pressing and pulling, heart moving: only rounding, some 1e-16 a step, parts them."""
    of = robot_of(Experiment.published("table-1-wam"))
    of = of._replace(tissue=of.tissue._replace(stiffness=810.0), sensor=of.sensor._replace(pole=0.0, lsb=(0.0,) * 3))
    structure = robot.RobotStructure(kind, integrator="euler")
    state = robot.init(chain(), structure, of, 0.0, FLOATS)
    # The torque of the last sample is given to a twin that takes it at once.
    world = TwinPhysics(
        TwinSettings(
            tissue=TissueSettings(kind=kind), motion=Motion(fade=0.1), substeps=1, gap=0.0, delay=0, pull_off=1e6
        )
    )
    signals = displacement(Motion(fade=0.1), np.arange(steps) * 1e-3)
    hearts = [robot.HeartSample(tuple(x), tuple(v)) for x, v in zip(*(each.tolist() for each in signals), strict=True)]
    draw, sent, normal = np.random.default_rng(3), holding(world), []
    for k, heart in enumerate(hearts):
        measured, _, _, _, state = robot.sense(chain(), structure, of, state, heart, (0.0,) * 3, FLOATS)
        np.testing.assert_allclose(world.truth().force, measured, rtol=0.0, atol=1e-7)
        normal.append(measured[2])
        before = sent
        if k % 50 == 0:
            sent = tuple((holding(world, lift=-4.0) + draw.normal(0.0, 0.1, 4)).tolist())
        joint = apply_transposed(JOINT_TO_MOTOR, sent)
        state = robot.move(chain(), structure, of, state, joint, (heart,), accelerate, FLOATS)
        world.advance(before, DRIVING)
        np.testing.assert_allclose(world.truth().q, state.q, rtol=0.0, atol=1e-9)
    assert np.ptp(normal) > 2.0


def test_a_torque_acts_after_the_delay():
    for delay in (0, 1, 3):
        world = TwinPhysics(TwinSettings(delay=delay))
        acting = [any(truth.torque) for truth in run(world, 5e-3)]
        assert acting == [k >= delay for k in range(5)]


@pytest.mark.parametrize("name", [*HEARTS, *RHYTHMS, *SCENARIOS])
def test_the_heart_moves_as_in_the_published_experiments(name):
    published = {"harmonics": "table-1-wam", "none": ""}.get(name, name)
    if published == name and name not in ("ventilator-hold", "cough", "amplitude-drift"):
        published = f"rhythm-{name}"
    motion = Experiment.published(published).motion if published else Motion(kind="none")
    heart = TwinHeart(motion_named(name, motion.seed), 5e-4)
    # 9 to 11 s, where rates step, lungs stop and coughs come; three blocks at once would hide a seam.
    instants = range(18_000, 22_000)
    found = np.array([heart.at(i) for i in instants])
    wanted = displacement(motion, np.array(instants) * 5e-4)
    np.testing.assert_allclose(found[:, 0], wanted[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], wanted[1], rtol=0.0, atol=1e-10)


def test_somebody_holds_the_arm_until_a_torque_acts():
    world = TwinPhysics(TwinSettings())
    start = world.q
    for _ in range(200):
        world.advance(NONE, IDLE)
        world.advance(NONE, DRIVING)
    assert world.q == start
    run(world, 0.05, lift=5.0)
    assert world.q != start
    world.place(HOME)
    world.advance(NONE, IDLE)
    assert world.q == HOME


def test_the_tip_starts_above_and_touches_where_the_posture_says():
    settings = TwinSettings(motion=motion_named("none"), gap=0.01, **FREE)
    world = TwinPhysics(settings)
    np.testing.assert_allclose(
        world.truth().tip, tip_at(settings.posture) + np.array([0.0, 0.0, 0.01]), rtol=0.0, atol=1e-12
    )
    truths = run(world, 0.6, lift=-1.0)
    first = next(k for k, truth in enumerate(truths) if truth.touching)
    assert truths[first].tip[2] == pytest.approx(tip_at(settings.posture)[2], abs=1e-4)
    assert np.abs([truth.force for truth in truths[:first]]).max() == 0.0
    assert_new(truths[first], settings)
    assert min(truth.force[2] for truth in truths) < -1.0


def test_an_attached_tip_pulls_until_it_comes_off_and_a_touching_one_never_pulls():
    for attached in (True, False):
        settings = TwinSettings(
            motion=motion_named("none"), gap=0.0, tissue=TissueSettings(attached=attached), pull_off=3.0, **FREE
        )
        world = TwinPhysics(settings)
        forces = np.array([truth.force[2] for truth in run(world, 0.25, lift=8.0)])
        assert forces.max() == pytest.approx(3.0, abs=0.3) if attached else forces.max() <= 0.0
        assert not world.truth().touching
        assert world.truth().force == (0.0, 0.0, 0.0)
        # Down again it sticks where it comes down: the old sideways deflection is forgotten.
        back = run(world, 1.0, lift=-12.0)
        assert_new(next(truth for truth in back if truth.touching), settings)
        assert min(truth.force[2] for truth in back) < -1.0


def test_an_idle_arm_sinks_slowly_on_its_shorted_motors():
    """Gravity against Kt²/R: the speed of J2 after the first tenth of a second, to a tenth."""
    world = TwinPhysics(TwinSettings(motion=motion_named("none"), gap=0.2, **FREE))
    run(world, 0.005)
    begin = world.q
    weight = inverse_dynamics(chain(), pose(chain(), begin, math), NONE, NONE)[1]
    run(world, 0.3, braked=IDLE)
    brake = TORQUE_CONSTANT**2 / WINDING * 2.0 * 28.25**2
    assert world.truth().qd[1] == pytest.approx(-weight / brake, rel=0.1)
    assert not any(world.truth().torque)


def test_one_idle_motor_brakes_its_own_turning_and_no_other():
    """With J2 and J3 turning such that motor 2 stands still, shorting motor 2 takes nothing away."""
    speeds = []
    for braked in (DRIVING, (False, True, False, False), (False, False, True, False)):
        world = TwinPhysics(TwinSettings(motion=motion_named("none"), gap=0.2, **FREE))
        run(world, 0.005)
        world._data.qvel[:] = 0.0, 16.8155 * 0.02, 28.25 * 0.02, 0.0
        world._settle()
        run(world, 0.005, braked=braked)
        speeds.append(np.array(world.truth().qd))
    weight = np.abs(speeds[0] - speeds[1]).max()
    # What differs is that motor 2 no longer helps against gravity, for 5 ms.
    assert weight < 0.1
    assert np.abs(speeds[0] - speeds[2]).max() > 0.2


def test_joints_end_at_their_stops():
    world = TwinPhysics(TwinSettings(motion=motion_named("none"), gap=0.2))
    for _ in range(1500):
        world.advance((1.0, 1.0, 0.5, -0.5), DRIVING)
    low, high = joint_ranges().T
    assert (np.array(world.q) > low - 0.1).all()
    assert (np.array(world.q) < high + 0.1).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"motion": Motion(kind="rhythm", heart_rate_hz=9.0)},
        {"stiffness": 0.0},
        {"stiffness": math.nan},
        {"delay": -1},
        {"substeps": 0},
        {"gap": -0.1},
        {"frame": "moon"},
        {"noise": -1.0},
        {"coulomb": (math.inf,) * 4},
    ],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        TwinSettings(**wrong)


def test_the_same_seed_is_the_same_world():
    def measured(seed):
        world = TwinPhysics(TwinSettings(seed=seed, gap=0.0))
        return [truth.measured for truth in run(world, 0.1)]

    assert measured(1) == measured(1)
    assert measured(1) != measured(2)


def test_a_twin_of_an_experiment_meets_what_the_simulation_meets(tmp_path):
    t = np.arange(0.0, 4.0, 0.01)
    rows = "\n".join(f"{x:g},{0.001 * math.sin(9.0 * x):.9f},0,{0.004 * math.sin(7.0 * x):.9f}" for x in t)
    (tmp_path / "heart.csv").write_text(f"t,x,y,z\n{rows}\n")
    text = """
    physics = "wam"
    stiffness = [600.0]
    delay = 2
    [motion]
    kind = "recording"
    file = "heart.csv"
    repeat = true
    start = 0.1
    [tissue]
    kind = "kelvin-voigt"
    viscosity = 1.5
    attached = false
    changes = [{ at = 0.05, factor = 3.0, duration = 0.1 }]
    [arm]
    coulomb = [1.0, 1.0, 1.0, 0.5]
    [sensor]
    noise = 0.002
    """
    (tmp_path / "e.toml").write_text(text)
    experiment = Experiment.from_toml(tmp_path / "e.toml")
    settings = twin_settings(str(tmp_path / "e.toml"), gap=0.0)
    assert (settings.motion, settings.tissue) == (experiment.motion, experiment.tissue)
    assert (settings.stiffness, settings.delay, settings.noise) == (600.0, 2, 0.002)
    assert (settings.coulomb, settings.lsb) == (experiment.arm.coulomb, experiment.sensor.lsb)
    world = TwinPhysics(settings)
    truths = run(world, 0.3, lift=-3.0)
    surface = displacement(experiment.motion, np.array([truth.time for truth in truths]))[0]
    np.testing.assert_allclose([truth.heart for truth in truths], surface, rtol=0.0, atol=1e-12)
    contact = TwinContact(settings, NONE[:3])
    contact.begin(True)
    pressed = [contact.press((0.0, 0.0, -0.005), NONE[:3], NONE[:3], NONE[:3], t, 0.0)[2] for t in (0.0, 0.1, 0.2)]
    assert pressed == pytest.approx([-3.0, -6.0, -9.0], rel=1e-3)
    file = str(tmp_path / "e.toml")
    assert unlike_the_simulation(file, None) == []
    assert twin_settings("table-1-wam").stiffness == 375.0, "the first of three"
    assert unlike_the_simulation("cough", None) == unlike_the_simulation(None, "cough") == []
    (tmp_path / "e.toml").write_text(text.replace("repeat = true", ""))
    (said,) = unlike_the_simulation(file, None)
    assert "repeats it, faded to rest" in said
    assert unlike_the_simulation(file, "cough") == [], "another heart was asked for"
    (said,) = unlike_the_simulation(file, "heart.csv:mm")
    assert "repeats heart.csv:mm, faded to rest" in said
    (tmp_path / "cables.toml").write_text("[arm]\ncable_hz = 30.0\nmass_error = 0.1\n")
    (said,) = unlike_the_simulation(str(tmp_path / "cables.toml"), None)
    assert said.startswith("NOT IN THE TWIN")
    assert said.endswith(": arm.cable_hz = 30.0")
    assert twin_settings(str(tmp_path / "e.toml")).motion.repeat, "no recording is as long as any flight"
    (tmp_path / "e.toml").write_text(text.replace("viscosity = 1.5", "viscosity = -1.0"))
    with pytest.raises(InputError, match=r"tissue\.viscosity"):
        TwinPhysics(twin_settings(str(tmp_path / "e.toml")))
    with pytest.raises(InputError, match="Did you mean 'cough'"):
        twin_settings("cuogh")
