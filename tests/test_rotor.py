"""f_i and m_i against MuJoCo, which knows nothing of Eqs. (2)-(6), with every rotor modelled as a body."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dashpot.control.rotor import Chain, rotation_about, rotor_terms
from dashpot.errors import InputError

JOINTS = 7


def random_rotation(rng):
    A, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return A * np.sign(np.linalg.det(A))


def random_inertia(rng, axis, *, axisymmetric=False):
    """A possible rotor: any orientation, any three moments; or symmetric about its axis."""
    if axisymmetric:
        along = np.outer(axis, axis)
        return rng.uniform(1e-3, 2e-3) * along + rng.uniform(1e-3, 2e-3) * (np.eye(3) - along)
    A = random_rotation(rng)
    return A @ np.diag(rng.uniform(1e-3, 2e-3, 3)) @ A.T


def random_chain(rng, *, geared, axisymmetric=False):
    axis = rng.normal(size=(JOINTS, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    ratio = rng.uniform(1.5, 120, JOINTS) * rng.choice([-1, 1], JOINTS) if geared else np.ones(JOINTS)
    return Chain(
        axis=axis,
        rotation=[random_rotation(rng) for _ in range(JOINTS)],
        inertia=[random_inertia(rng, z, axisymmetric=axisymmetric) for z in axis],
        ratio=ratio,
    )


def quat(A):
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(A).ravel())
    return q


def body(parent, name, rng, *, A=None, inertia=None, position=None):
    child = parent.add_body(name=name)
    child.pos = rng.uniform(-0.3, 0.3, 3) if position is None else position
    if A is not None:
        child.quat = quat(A)
    M = random_inertia(rng, None) * 50 if inertia is None else inertia
    child.explicitinertial = True
    child.mass = rng.uniform(0.5, 3)
    # Links have their mass anywhere; a rotor has it on its axis, at the body's origin.
    child.ipos = rng.uniform(-0.1, 0.1, 3) if inertia is None else np.zeros(3)
    child.fullinertia = [M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2]]
    return child


def hinge(on, name, axis):
    return on.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)


def motion(rng):
    return rng.uniform(-3, 3, JOINTS), rng.uniform(-4, 4, JOINTS), rng.uniform(-20, 20, JOINTS)


def direct_drive(chain, rng, q, qd, qdd):
    """Rotor body carries hinge i, the link is welded to it; gives motor torque and torque at the weld."""
    spec = mujoco.MjSpec()
    parent = spec.worldbody
    for i in range(JOINTS):
        rotor = body(parent, f"rotor{i}", rng, A=chain.rotation[i], inertia=chain.inertia[i])
        hinge(rotor, f"j{i}", chain.axis[i])
        parent = body(rotor, f"link{i}", rng, position=rng.uniform(-0.2, 0.2, 3))
        # The torque across the weld about a point on the joint axis: the site sits at the joint's anchor.
        parent.add_site(name=f"s{i}", pos=-np.asarray(parent.pos))
        spec.add_sensor(
            name=f"t{i}",
            type=mujoco.mjtSensor.mjSENS_TORQUE,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"s{i}",
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
    mujoco.mj_inverse(model, data)
    sensed = np.array([data.sensor(f"t{i}").data @ chain.axis[i] for i in range(JOINTS)])
    return data.qfrc_inverse.copy(), sensed


def geared(chain, rng, q, qd, qdd):
    """Each rotor has its own hinge on link i-1, turning N times; gives link-side motor and link torques."""
    spec = mujoco.MjSpec()
    parent = spec.worldbody
    for i in range(JOINTS):
        at = rng.uniform(-0.3, 0.3, 3)
        rotor = body(parent, f"rotor{i}", rng, A=chain.rotation[i], inertia=chain.inertia[i], position=at)
        hinge(rotor, f"r{i}", chain.axis[i])
        parent = body(parent, f"link{i}", rng, A=chain.rotation[i], position=at)
        hinge(parent, f"j{i}", chain.axis[i])
    model = spec.compile()
    data = mujoco.MjData(model)
    at_dof = {name: [model.joint(f"{name}{i}").dofadr[0] for i in range(JOINTS)] for name in "rj"}
    for name, N in (("r", chain.ratio), ("j", 1.0)):
        data.qpos[at_dof[name]], data.qvel[at_dof[name]], data.qacc[at_dof[name]] = N * q, N * qd, N * qdd
    mujoco.mj_inverse(model, data)
    return chain.ratio * data.qfrc_inverse[at_dof["r"]], data.qfrc_inverse[at_dof["j"]]


@pytest.mark.parametrize("seed", range(25))
def test_direct_drive_agrees_with_mujoco(seed):
    print("seed", seed)
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, geared=False)
    q, qd, qdd = motion(rng)
    u, tau_s = direct_drive(chain, rng, q, qd, qdd)
    f = u - chain.apparent_inertia * qdd - tau_s
    # f is a small difference of large torques: the torques set the rounding.
    np.testing.assert_allclose(rotor_terms(chain, q, qd, qdd), f, rtol=1e-9, atol=1e-11 * abs(u).max())


@pytest.mark.parametrize("seed", range(25))
def test_geared_rotors_agree_with_mujoco(seed):
    print("seed", seed)
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, geared=True)
    q, qd, qdd = motion(rng)
    u_rotor, _ = geared(chain, rng, q, qd, qdd)
    f = u_rotor - chain.apparent_inertia * qdd
    scale = abs(u_rotor).max()
    np.testing.assert_allclose(rotor_terms(chain, q, qd, qdd), f, rtol=1e-9, atol=1e-11 * scale)


def paper_f(chain, q, qd, qdd, *, literal_6=False, literal_2=False):
    """Eqs. (2)-(6) symbol by symbol for direct drive, frame i-1 being the joint's frame at angle zero.

    A[j] maps frame j to base coordinates, so A_j^0 = A[j].T and A_{i-1}^i = A[i-1].T A[i].
    """
    A, turned = [chain.rotation[0]], []
    for i in range(JOINTS):
        turned.append(A[i] @ rotation_about(chain.axis[i], q[i]))
        A.append(turned[i] @ (chain.rotation[i + 1] if i + 1 < JOINTS else np.eye(3)))
    w, wd, f = np.zeros(3), np.zeros(3), np.zeros(JOINTS)
    for i in range(1, JOINTS + 1):
        before, here, z0 = A[i - 1], A[i], chain.axis[i - 1]
        z = before @ z0
        body_M = chain.inertia[i - 1]
        # (2) needs M_i in base coordinates; a data sheet's constant matrix in its place is the trap.
        M_i = body_M if literal_2 else turned[i - 1] @ body_M @ turned[i - 1].T
        M_r = before.T @ M_i @ before  # (2)
        w_i = w + z * qd[i - 1]  # (4)
        back, forth = before.T @ here, here.T @ before  # A_{i-1}^i, A_i^{i-1}
        first, second = here.T @ w_i, forth @ M_r @ back @ here.T @ w_i
        gyro = np.cross(back @ first, second) if literal_6 else back @ np.cross(first, second)
        f[i - 1] = z0 @ (M_r @ (before.T @ wd) + gyro + M_r @ np.cross(before.T @ w, z0 * qd[i - 1]))  # (6)
        wd = wd + z * qdd[i - 1] + np.cross(w, z * qd[i - 1])  # (5)
        w = w_i
    return f


@pytest.mark.parametrize("seed", range(5))
def test_corrected_reading_of_equations_2_to_6_is_this_one_and_the_literal_ones_are_not(seed):
    print("seed", seed)
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, geared=False)
    q, qd, qdd = motion(rng)
    f = rotor_terms(chain, q, qd, qdd)
    np.testing.assert_allclose(paper_f(chain, q, qd, qdd), f, rtol=1e-10, atol=1e-13)
    assert abs(paper_f(chain, q, qd, qdd, literal_6=True) - f)[1:].max() > 0.01 * abs(f).max()
    assert abs(paper_f(chain, q, qd, qdd, literal_2=True) - f)[1:].max() > 0.01 * abs(f).max()


@pytest.mark.parametrize("gears", [False, True])
def test_first_joint_of_a_fixed_base_has_no_f(gears):
    rng = np.random.default_rng(1)
    chain = random_chain(rng, geared=gears)
    f = rotor_terms(chain, *motion(rng))
    assert abs(f[0]) < 1e-12 * abs(f).max()


@pytest.mark.parametrize("gears", [False, True])
def test_axisymmetric_rotor_feels_only_the_link_acceleration_along_its_axis_divided_by_the_gear(gears):
    rng = np.random.default_rng(2)
    chain = random_chain(rng, geared=gears, axisymmetric=True)
    q, qd, qdd = motion(rng)
    wd, w, A, along = np.zeros(3), np.zeros(3), np.eye(3), []
    for i in range(JOINTS):
        z = A @ chain.rotation[i] @ chain.axis[i]
        along.append(z @ wd)
        wd, w = wd + z * qdd[i] + np.cross(w, z * qd[i]), w + z * qd[i]
        A = A @ chain.rotation[i] @ rotation_about(chain.axis[i], q[i])
    expected = chain.apparent_inertia / chain.ratio * along
    np.testing.assert_allclose(rotor_terms(chain, q, qd, qdd), expected, rtol=1e-9, atol=1e-12)


def test_a_balanced_rotor_need_not_be_axisymmetric_and_then_keeps_a_product_of_velocities():
    turn = rotation_about([1.0, 0, 0], 0.7)  # second axis tilted against the first, principal axes aligned
    chain = Chain([[0, 0, 1.0]] * 2, [np.eye(3), turn], [np.diag([1e-3, 2e-3, 2.5e-3])] * 2)
    qd = np.array([3.0, 0.0])
    wx, wy, _ = turn.T @ [0, 0, 3.0]
    f = rotor_terms(chain, [0.3, 0.4], qd, [0.0, 0.0])
    s, c = np.sin(0.4), np.cos(0.4)
    x, y = c * wx + s * wy, -s * wx + c * wy
    assert f[1] == pytest.approx((2e-3 - 1e-3) * x * y)
    assert abs(f[1]) > 1e-4


def test_terms_vectorise_over_samples():
    rng = np.random.default_rng(3)
    chain = random_chain(rng, geared=True)
    many = [np.stack(x) for x in zip(*(motion(rng) for _ in range(6)), strict=True)]
    one_by_one = [rotor_terms(chain, *(x[k] for x in many)) for k in range(6)]
    np.testing.assert_allclose(rotor_terms(chain, *many), one_by_one, rtol=1e-12, atol=1e-12)


def arm(rng, chain, *, ref=0.0, extra=False):
    """A rigid arm whose frames are the chain's, with a welded body in every second gap."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    parent = spec.worldbody
    for i in range(JOINTS):
        A = chain.rotation[i]
        if i % 2:
            half = random_rotation(rng)
            parent, A = body(parent, f"adapter{i}", rng, A=half), half.T @ A
        if extra and i == 3:
            parent = body(parent, "slide", rng)
            parent.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        parent = body(parent, f"link{i}", rng, A=A @ rotation_about(chain.axis[i], ref))
        joint = hinge(parent, f"j{i}", chain.axis[i])
        joint.armature, joint.ref = 0.1 * (i + 1), ref
    return spec.compile()


NAMES = [f"j{i}" for i in range(JOINTS)]


@pytest.mark.parametrize("ref", [0.0, 0.4])
def test_from_mujoco_reads_the_frames_of_the_model(ref):
    rng = np.random.default_rng(4)
    chain = random_chain(rng, geared=True)
    model = arm(rng, chain, ref=ref)
    read = Chain.from_mujoco(model, NAMES, ratio=chain.ratio, inertia=chain.inertia)
    np.testing.assert_allclose(read.rotation, chain.rotation, atol=1e-12)
    move = motion(rng)
    np.testing.assert_allclose(rotor_terms(read, *move), rotor_terms(chain, *move), rtol=1e-9, atol=1e-10)


def test_from_mujoco_takes_the_armature_as_the_reflected_rotor():
    rng = np.random.default_rng(5)
    chain = random_chain(rng, geared=False)
    read = Chain.from_mujoco(arm(rng, chain), NAMES, ratio=50.0)
    np.testing.assert_allclose(read.apparent_inertia, 0.1 * np.arange(1, 8), rtol=1e-12)


def test_from_mujoco_refuses_what_is_not_a_serial_arm_of_hinges():
    rng = np.random.default_rng(6)
    model = arm(rng, random_chain(rng, geared=False), extra=True)
    with pytest.raises(InputError, match=r"^joint 'j3': must follow 'j2' with no other joint between$"):
        Chain.from_mujoco(model, NAMES)
    with pytest.raises(InputError, match=r"^joint 'j1': must follow the base with no other joint between$"):
        Chain.from_mujoco(model, NAMES[1:])
    with pytest.raises(InputError, match="joint 'elbow': not in the model, which has j0, j1, j2"):
        Chain.from_mujoco(model, ["elbow"])
    with pytest.raises(InputError, match="joint 'slide': must be a hinge"):
        Chain.from_mujoco(model, ["slide"])


Z, ONE, ROTOR = [0, 0, 1.0], np.eye(3), np.eye(3) * 1e-3


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (dict(axis=[[0, 0, 2.0]]), "joint '1': axis = [0.0, 0.0, 2.0]: must be a unit vector"),
        (dict(rotation=[np.diag([1, 1, -1])]), "must be a rotation matrix"),
        (dict(inertia=[np.diag([1.0, 1.0, 3.0])]), "none above the sum of the others"),
        (dict(inertia=[np.diag([-1.0, 1.0, 1.0])]), "its principal moments >= 0"),
        (dict(ratio=[0.0]), "joint '1': ratio = 0.0: must not be zero"),
        (dict(inertia=np.eye(3)), "inertia.shape = (3, 3): must have shape (1, 3, 3)"),
        (dict(inertia=[np.eye(3) * np.nan]), "inertia: must be finite"),
    ],
)
def test_errors_name_joint_quantity_value_and_rule(arguments, text):
    with pytest.raises(InputError) as caught:
        Chain(**(dict(axis=[Z], rotation=[ONE], inertia=[ROTOR]) | arguments))
    assert text in str(caught.value)


def test_a_wrong_number_of_joints_is_refused():
    with pytest.raises(InputError, match=r"q\.shape"):
        rotor_terms(Chain([Z], [ONE], [ROTOR]), [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    with pytest.raises(InputError, match=r"qdd\.shape"):
        rotor_terms(Chain([Z], [ONE], [ROTOR]), [0.0], [0.0], 0.0)
