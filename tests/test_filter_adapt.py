"""Adaptation rules and the "current" model inside the compiled satellite filters, against dense filters."""

import numpy as np
import pytest

import starwise
import test_colored
from batches import NAV, OBS, QUICK
from colored_twin import Twin
from skies import RECEIVER, options, sky
from starwise.api_inertial import _configs
from starwise.config import WEIGHTING_RULES, RunConfig
from starwise.constants import EPOCH_RESET, ROW_GATED, WGS84_E2
from starwise.errors import StarwiseError
from starwise.estimators import filter as filter_module
from starwise.estimators.adaptive import RULES, factors, step
from starwise.estimators.filter import filter_options, filter_rows
from starwise.kernels.filter_clocks import _lead_with
from starwise.kernels.filter_epoch import linearise
from starwise.kernels.rangemodel import epoch_corrections
from starwise.models.process import clocks_from, matrices, motion_from
from starwise.models.pseudorange import empty_row_model
from starwise.types import Layout, Linear, State

CODE, RATE = 3.0, 0.1  # m, m/s
TWO_SYSTEMS = np.array([0] * 6 + [2] * 5)
CAR = np.array([12.0, -9.0, 4.0])
FADING = [name for name in RULES if name not in (*WEIGHTING_RULES, "none")]


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Filters that never start anew: what is left is the filter's own equations."""

    def forever(*arguments):
        return filter_options(*arguments)._replace(patience=1 << 30, weak_patience=1 << 30)

    monkeypatch.setattr(filter_module, "filter_options", forever)


def start_of(motion, n_clocks):
    x = np.zeros(motion.nk + 2 * n_clocks)
    P = np.diag([4.0] * 3 + [0.004] * 3 + [0.01] * (motion.nk - 6) + [4.0] * n_clocks + [0.004] * n_clocks)
    x[:3], x[3:6] = RECEIVER + np.array([1.0, -1.0, 2.0]), CAR
    x[motion.nk : motion.nk + n_clocks] = np.linspace(1e4, 2e4, n_clocks)
    x[motion.nk + n_clocks :] = 40.0
    return x, P


def dense(epochs, rows, config, start, n_clocks=2):
    """The white filter with a rule in its plainest form; positions and their covariances."""
    motion, clocks, rule = motion_from(config), clocks_from(config), RULES[config.adaptation]
    nk, out, model = (
        motion.nk,
        empty_row_model(len(rows.code_m)),
        options(fixed_code_sigma_m=CODE, fixed_rate_sigma_mps=RATE),
    )
    names = [f"{kind}.{k}" for kind in ("clk", "drift") for k in range(n_clocks)]
    state = State(int(epochs.t_ns[0]), Layout((*motion.names, *names)), *start)
    memory, pos, cov = rule.fresh(), [], []
    for e, t_ns in enumerate(epochs.t_ns):
        a, b = int(epochs.offsets[e]), int(epochs.offsets[e + 1])
        dt = (int(t_ns) - state.t_ns) * 1e-9
        up = state.x[:3] / [1.0, 1.0, 1.0 - WGS84_E2]
        Phi, Q = matrices(motion, clocks, n_clocks, dt, up / np.linalg.norm(up))
        epoch_corrections(model, t_ns, rows, a, b, *(Phi @ state.x)[:3], True, out)

        def measure(belief, a=a, b=b):
            v, H, r = [], [], []
            for i in range(a, b):
                c = nk + int(rows.clock[i])
                v1, v2, ux, uy, uz, gx, gy, gz = linearise(rows, out, i, belief.x, True, c, c + n_clocks)
                h = np.zeros((2, len(belief.x)))
                h[0, :3], h[0, c] = (-ux, -uy, -uz), 1.0
                h[1, :3], h[1, 3:6], h[1, c + n_clocks] = (gx, gy, gz), (-ux, -uy, -uz), 1.0
                v, H, r = [*v, v1, v2], [*H, *h], [*r, out.code_var[i], out.rate_var[i]]
            return Linear(np.array(v), np.array(H), np.array(r), np.arange(len(v)))

        groups = None if config.method == "ekf" else [(2 * k, 2 * k + 1) for k in range(b - a)]
        chosen = rule if e > 0 else RULES["none"]  # nothing has been predicted before the first epoch
        state, _, _, later = step(state, Phi, Q, int(t_ns), measure, chosen, memory, groups)
        memory = later if e > 0 else memory
        pos.append(state.x[:3])
        cov.append(state.P[:3, :3])
    return np.array(pos), np.array(cov)


@pytest.mark.laws
@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("method", ["ekf", "s3ekf"])
@pytest.mark.parametrize("name", list(RULES))
def test_the_compiled_white_filter_is_the_dense_one(name, method):
    """Noise larger than the filter is told, and outliers: every rule has something to do."""
    epochs, rows, _ = sky(
        11, 60, seed=4, systems=TWO_SYSTEMS, velocity=CAR, drift_mps=40.0, code_sigma=1.5 * CODE, rate_sigma=2.0 * RATE
    )  # fmt: skip
    rng = np.random.default_rng(4)
    rows.code_m[rng.choice(len(rows.code_m), 40, replace=False)] += 20.0
    config = RunConfig(
        method=method, dynamics="vehicle", error_model="white", adaptation=name, gate_probability=1e-300,
        process={"acceleration_sigma_mps2": 0.05}, clock={"drift_psd_m2_per_s3": 1e-4},
    )  # fmt: skip
    start = start_of(motion_from(config), 2)
    model = options(fixed_code_sigma_m=CODE, fixed_rate_sigma_mps=RATE)
    ep, out = filter_rows(epochs, rows, model, 2, config, start)
    pos, cov = dense(epochs, rows, config, start)
    plain, _ = dense(epochs, rows, config.with_options({"adaptation": "none"}), start)
    # m: float64 ranges carry 4e-9 m; fading by up to 1e3 in every epoch makes clocks so uncertain that rounding shows
    loose = name in FADING[:3]
    np.testing.assert_allclose(ep.pos, pos, atol=1e-3 if loose else 1e-6, rtol=0)
    np.testing.assert_allclose(ep.cov_pos, cov, atol=1e-7, rtol=1e-3 if loose else 1e-6)
    assert np.array_equal(ep.cov_pos, np.swapaxes(ep.cov_pos, 1, 2))
    assert (np.abs(pos - plain).max() > 0.01) == (name != "none")  # m
    assert ((out.status == ROW_GATED).any()) == (name == "igg3")


class Adaptive(Twin):
    """The dense coloured filter with a rule: motion and clocks fade, errors of ranges do not."""

    def prepare(self, rule):
        self.rule, self.memory, self.Q, self.answers = rule, rule.fresh(), None, []

    def predict(self, t_ns):
        super().predict(t_ns)
        dt = (t_ns - self.before.t_ns) * 1e-9
        names = [n for n in self.state.layout.names if n.split(".")[0] in ("pos", "vel", "acc", "clk", "drift")]
        active = sum(n.startswith("clk.") for n in names)
        self.Q = self.motion_matrices(dt, active, self.before.x)[2]
        self.names = names

    def before_update(self, everything):
        if self.Q is None:
            return
        s, rows = self.state, everything(self.state, 0)
        at = s.layout.indices(self.names)
        A = np.zeros((len(at), len(s.x)))
        A[np.arange(len(at)), at] = 1.0
        moving = np.isin(np.arange(len(s.x)), at)
        Hm, He = rows.H * moving, rows.H * ~moving
        Q = A.T @ self.Q @ A
        own, both, q = (np.einsum("mi,ij,mj->m", a, B, b) for a, B, b in ((Hm, s.P, Hm), (Hm, s.P, He), (Hm, Q, Hm)))
        lasting = np.einsum("mi,ij,mj->m", He, s.P, He)
        p, rest = np.maximum(own - q + both, 0.0), np.maximum(lasting + both, 0.0)
        found, _, self.memory = factors(self.rule, self.memory, rows.v, p, q, rows.r + rest)
        self.answers.append(max(found.fading, found.q_factor))
        D = np.where(moving, np.sqrt(found.fading), 1.0)
        P = D[:, None] * (s.P - Q) * D + found.q_factor * Q
        self.state = State(s.t_ns, s.layout, s.x, 0.5 * (P + P.T))


def speed_up(rows, extra, pos, t_s):
    """Let the receiver accelerate for ``t_s``; second order of the range left out, centimetres in half a minute."""
    u = rows.sat_pos - pos
    along = (u / np.linalg.norm(u, axis=1)[:, None]) @ np.array([1.5, -1.0, 1.0])  # m/s^2
    rows.code_m[:] -= 0.5 * t_s**2 * along
    extra.code2_m[:] -= 0.5 * t_s**2 * along
    rows.rate_mps[:] -= t_s * along


@pytest.mark.laws
@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize(("name", "method"), [*((name, "s3ekf") for name in FADING), ("strong_tracking", "ekf")])
def test_the_compiled_coloured_filter_is_the_dense_one(name, method, monkeypatch):
    errors, epochs, rows, extra, truth = test_colored.scene(velocity=test_colored.CAR, n_epochs=45)
    speed_up(rows, extra, np.repeat(truth, 13, axis=0), np.maximum(np.repeat(np.arange(45), 13) - 12.0, 0.0))
    config = test_colored.configuration("vehicle", method, adaptation=name)
    made = []

    def twin(*arguments):
        made.append(Adaptive(*arguments))
        made[0].prepare(RULES[name])
        return made[0]

    monkeypatch.setattr(test_colored, "Twin", twin)
    test_colored.compare(errors, epochs, rows, extra, config, test_colored.CAR)
    assert max(made[0].answers) > 1.01


@pytest.mark.laws
@pytest.mark.parametrize("method", ["ekf", "s3ekf"])
def test_the_current_model_is_that_of_the_dense_filter(method):
    """Coloured errors; the acceleration is anything but zero: its variance differs from axis to axis."""
    errors, epochs, rows, extra, _ = test_colored.scene(velocity=test_colored.CAR, n_epochs=30)
    config = test_colored.configuration(
        "vehicle", method, process={"model": "current", "acceleration_max_mps2": 1.5, "acceleration_tau_s": 4.0}
    )
    x, P = test_colored.belief(config, test_colored.CAR, 2)
    x[6:9] = [0.9, -0.6, 0.7]
    test_colored.compare_from(errors, epochs, rows, extra, config, (x, P))


def test_rules_that_make_no_sense_are_refused():
    for name in WEIGHTING_RULES:
        with pytest.raises(StarwiseError, match="coloured errors"):
            RunConfig(adaptation=name)
        assert RunConfig(adaptation=name, error_model="white").adaptation == name
    with pytest.raises(StarwiseError, match="of filters"):
        RunConfig(adaptation="fading", method="lsq")
    with pytest.raises(StarwiseError):
        RunConfig(adaptation="best")


def test_every_rule_has_its_word():
    for name in RULES:
        assert RunConfig(adaptation=name, error_model="white").adaptation == name


def test_rounding_does_not_choose_who_leads():
    """The median of an even number lies between two: of equally near ones that of less variance comes first."""
    epochs, rows, truth = sky(6)
    out, order = empty_row_model(6), np.arange(6)
    epoch_corrections(options(), epochs.t_ns[0], rows, 0, 6, *truth[0], True, out)
    rows.code_m[:] += [2.0, -2.0, 5.0, -5.0, 9.0, -9.0]
    x = np.concatenate([truth[0], [1e4, 0.0]])
    for noise in (0.0, 1e-8, -1e-8):
        work = test_colored.work_space(6, 5)
        work.order[:] = order
        rows.code_m[1] += noise
        _lead_with(rows, out, 6, x, 3, np.zeros(1, np.int64), 0.0, work)
        assert work.order[0] == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"noise": {"code_m": 5.0}, "method": "s3ekf"}, "errors.code_white_m"),
        ({"errors": {"slope_m": 1.0}, "method": "lsq", "error_model": "white"}, "coloured error model"),
        ({"clock": {"bias_psd_m2_per_s": 1.0}, "method": "lsq"}, "are of filters"),
        ({"noise": {"code_m": 5.0}, "method": "lsq", "error_model": "white"}, None),
        ({"noise": {"rate_mps": 0.3}, "clock": {"bias_psd_m2_per_s": 1.0}, "method": "s3ekf"}, None),
    ],
)
def test_options_without_effect_are_told(given, said):
    notes = starwise.solve(OBS, NAV, config=RunConfig.from_dict({**given, "end": QUICK.end})).provenance["notes"]
    assert [said in note for note in notes] == ([True] if said else [])


def test_tied_clocks_name_nobody_beside_inertial_readings():
    with pytest.raises(StarwiseError, match="satellite filters"):
        _configs("none", None, {"clock.isolate": True})


@pytest.mark.laws
@pytest.mark.parametrize("name", ["strong_tracking", "iae_q"])
def test_a_filter_that_starts_anew_has_forgotten_its_innovations(name):
    """After a leap of 200 m the filter is the one that never was anywhere else."""
    epochs, rows, truth = sky(9, 90, seed=5, code_sigma=1.5 * CODE, rate_sigma=RATE)
    late = np.arange(len(rows.code_m)) >= 40 * 9
    u = rows.sat_pos - np.repeat(truth, 9, axis=0)
    rows.code_m[late] -= ((u / np.linalg.norm(u, axis=1)[:, None]) @ [120.0, -120.0, 100.0])[late]
    config = RunConfig(method="s3ekf", dynamics="vehicle", error_model="white", adaptation=name)
    model = options(fixed_code_sigma_m=CODE, fixed_rate_sigma_mps=RATE)
    ep, _ = filter_rows(epochs, rows, model, 1, config)
    first = int(np.flatnonzero(ep.status == EPOCH_RESET)[0])
    assert 40 < first < 50
    a = int(epochs.offsets[first])
    rest = type(rows)(*(part[a:].copy() for part in rows))
    fresh, _ = filter_rows(type(epochs)(epochs.t_ns[first:], epochs.offsets[first:] - a), rest, model, 1, config)
    np.testing.assert_allclose(ep.pos[first:], fresh.pos, atol=1e-5, rtol=0)  # m: least squares starts elsewhere
