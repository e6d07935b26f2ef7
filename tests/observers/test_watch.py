"""What the filters make of their innovations, by the numbers of docs/ukf.md: gate, restarts, trust, and the scale of the deviations."""

from __future__ import annotations

import math
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from observers.model import Model, Variable
from observers.status import CODE
from observers.vigilance import Watch, status_of, verdict

MODEL = Model(
    name="pair",
    states=[Variable("a", nominal=2.0), Variable("b", nominal=5.0)],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [x.b, -x.a],
    output=lambda x, u, p, t: [x.a, x.b],
)
N = 2
VARIANCES = np.array([0.25, 4.0])
SETTLED = 2 * N  # samples until the estimate counts, where the noise is given


class Watched:
    """Sees samples whose innovations are given in deviations of either output; `level` of theirs multiplies those of the filter."""

    def __init__(self, known: bool = True, weighted: bool = False, gate: float = 10.0, samples: int = 0):
        self.watch, self.gate = Watch(MODEL, N, known, weighted), gate
        memory, innovation, valid, limit = (
            ca.SX.sym(name, size) for name, size in (("m", self.watch.state.total), ("e", 2), ("v", 2), ("gate", 1))
        )
        tuning = SimpleNamespace(false_alarm=1e-4, gate=limit, deviation_limit=0.3)
        S = ca.DM(VARIANCES)
        outlying = self.watch.gated(memory, innovation, S, valid, limit)
        acting = ca.logic_and(valid, ca.logic_not(outlying))
        squared = ca.sumsqr(ca.if_else(acting, innovation / ca.sqrt(S), 0))
        said = verdict(self.watch, memory, squared, innovation, S, valid, outlying, tuning)
        status = status_of(said, valid, ca.SX(1), ca.DM.zeros(2), tuning, MODEL.states)
        deviations = self.watch.deviations(said.memory, ca.DM(VARIANCES))
        out = [outlying, said.inflate, said.restart, status, deviations, self.watch.again(said.memory), said.memory]
        self.function = ca.Function("watch", [memory, innovation, valid, limit], [ca.densify(ca.SX(o)) for o in out])
        self.memory = self.watch.start
        self.calm(samples)

    def __call__(self, sizes: tuple[float, float], valid: tuple[int, int] = (1, 1)) -> SimpleNamespace:
        innovation = np.where(valid, sizes * np.sqrt(VARIANCES), 0)
        outlying, inflate, restart, status, deviations, again, self.memory = self.function(
            self.memory, innovation, valid, self.gate
        )
        return SimpleNamespace(
            outlying=outlying.full().ravel().tolist(),
            done="restart" if restart else "inflate" if inflate else "",
            status=int(status),
            factor=deviations.full().ravel() / np.sqrt(VARIANCES),
            again=float(again),
        )

    def calm(self, samples: int) -> list[int]:
        """Statuses over samples of a third of a deviation, of either sign in turns."""
        return [self(np.array([1, -1]) * (-1) ** k / 3).status for k in range(samples)]


def until(watched: Watched, sizes: tuple[float, float], most: int = 200) -> tuple[int, str]:
    """How many such samples until something is done, and what."""
    for k in range(1, most + 1):
        if done := watched(sizes).done:
            return k, done
    return most, ""


@pytest.mark.parametrize("output", [0, 1])
def test_an_output_beyond_the_gate_is_an_outlier_once_the_estimate_counts(output: int) -> None:
    for samples, size, outlier in (
        (SETTLED - 1, 10.1, 0), (SETTLED, 10.1, 1), (SETTLED, 9.9, 0), (SETTLED, -10.1, 1), (SETTLED, math.inf, 1),
    ):  # fmt: skip
        sizes = np.eye(2)[output] * (size if math.isfinite(size) else 1e200)
        said = Watched(samples=samples)(sizes)
        assert said.outlying == list(np.eye(2)[output] * outlier)
        assert (said.status == CODE.outlier) == outlier
    assert Watched(samples=SETTLED, gate=3.0)(3.1 * np.eye(2)[output]).outlying == list(np.eye(2)[output])


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_one_outlier_contradicts_nothing_and_a_second_in_a_row_does(size: float) -> None:
    """Whatever the size of the innovations before it; nor does one among many, ten samples later."""
    watched = Watched()
    for k in range(60):
        watched(size * np.array([1.0, -1.0]) * (-1) ** k)
    assert watched((40.0, 0.0)).status == CODE.outlier
    assert watched((size, 0.0)).status == CODE.estimating
    watched.calm(10)
    assert [watched((40.0, 0.0)).status for _ in range(3)] == [CODE.outlier, CODE.inconsistent, CODE.inconsistent]


def test_it_is_settling_until_then_and_estimating_afterwards() -> None:
    assert Watched().calm(SETTLED + 2) == [CODE.settling] * SETTLED + [CODE.estimating] * 2
    assert (
        Watched(known=False).calm(32) == [CODE.settling] * 30 + [CODE.estimating] * 2
    )  # the noise is to be found first


def test_ten_outliers_in_a_row_start_the_covariance_again_and_twenty_after_that_the_estimate() -> None:
    """Then forty; 60 samples that fit end it."""
    far = (40.0, 0.0)
    watched = Watched(samples=SETTLED)
    assert until(watched, far) == (10, "inflate")
    watched.calm(SETTLED)
    assert until(watched, far) == (20, "restart")
    watched.calm(SETTLED)
    assert until(watched, far) == (40, "inflate")
    watched.calm(200)
    assert until(watched, far) == (10, "inflate")


def test_a_sample_that_fits_takes_back_two_outliers_and_a_missing_one_none() -> None:
    watched, far = Watched(samples=SETTLED), (40.0, 0.0)
    for _ in range(9):
        watched(far)
    watched(far, (0, 0))
    watched.calm(1)
    assert until(watched, far) == (3, "inflate")


@pytest.mark.parametrize("far, forgotten", [(4, False), (5, True)])
def test_what_samples_far_off_taught_is_forgotten_once_twenty_in_a_row_fit(far: int, forgotten: bool) -> None:
    """Five that are far off by themselves, but within the gate, so that they acted; fewer leave the covariance as it is."""
    watched = Watched(samples=100)
    for _ in range(far):
        assert watched((4.5, 0.0)).done == ""
    done, quiet = [], []
    for k in range(300):
        done.append(watched(np.array([1, -1]) * (-1) ** k / 3).done)
        quiet.append(int(watched.watch.state.unpack(watched.memory).quiet))
    assert [what for what in done if what] == (["inflate"] if forgotten else [])
    if forgotten:
        assert quiet[done.index("inflate")] == 20


def test_outliers_taught_nothing_and_nothing_of_it_is_forgotten() -> None:
    watched = Watched(samples=100)
    done = [watched((50.0, 0.0) if k % 4 == 0 and k < 40 else (1 / 3, -1 / 3)).done for k in range(300)]
    assert done == [""] * 300


def test_contradictions_that_last_start_the_covariance_again_twice_and_the_estimate_never() -> None:
    """Every fifth sample far off: too few for the cumulative sum, and trust never comes back."""
    watched = Watched(samples=100)
    done = [watched((4.5 * (-1) ** k, 0.0) if k % 5 == 0 else (1 / 3, -1 / 3)).done for k in range(1500)]
    begins = [k for k in range(1500) if done[k]]
    assert [done[k] for k in begins] == ["inflate", "inflate"]
    assert 100 <= begins[0] < 130 and begins[1] - begins[0] == 201


def test_a_gate_of_a_million_turns_restarts_off() -> None:
    watched = Watched(samples=SETTLED, gate=1e6)
    assert until(watched, (1e7, 0.0)) == (200, "")


def test_samples_in_a_row_far_off_but_within_the_gate_start_it_again_at_the_eleventh() -> None:
    """8 of nu' S^-1 nu / dof count at most, 2.5 are usual, and 60 are too many; what is missing does not count."""
    watched = Watched(samples=SETTLED)
    for _ in range(10):
        assert watched((9.0, 9.0)).done == ""
    for _ in range(5):
        assert watched((9.0, 9.0), (0, 0)).done == ""
    said = watched((9.0, 9.0))
    assert (said.done, said.status) == ("inflate", CODE.inconsistent)
    watched = Watched(samples=SETTLED)
    done = [watched(1.5 * np.array([1.0, -1.0]) * (-1) ** k).done for k in range(200)]
    assert set(done) == {""}  # 2.25 is below what is usual


@pytest.mark.parametrize("sizes", [(1.0, 0.0), (0.0, -1.0)])
def test_innovations_on_one_side_start_the_covariance_again_twice_and_the_estimate_never(
    sizes: tuple[float, float],
) -> None:
    """Three deviations of what was learned, a third, of either output, of which two count: one and a half a sample, beyond 15, and once
    it has settled beyond 30."""
    watched = Watched(known=False, samples=100)
    assert until(watched, sizes) == (11, "inflate")
    assert until(watched, sizes) == (51, "inflate")
    assert until(watched, sizes, 1000) == (1000, "")


def test_of_innovations_on_one_side_nothing_counts_that_is_usual_or_missing() -> None:
    watched = Watched(known=False, samples=100)
    assert until(watched, (0.5 / 3, 0.0), 60) == (60, "")
    watched = Watched(known=False, samples=100)
    for _ in range(10):
        watched((1.0, 0.0))
        watched((9.0, 0.0), (0, 1))
    assert watched((1.0, 0.0)).done == "inflate"


@pytest.mark.parametrize("given", [{"known": True}, {"weighted": True}])
def test_where_the_noise_is_given_or_the_design_a_papers_innovations_on_one_side_start_nothing_again(
    given: dict[str, bool],
) -> None:
    """A model that is a little wrong keeps to one side for good, a paper's design until it has converged."""
    watched = Watched(**given, samples=100)
    assert until(watched, (1.0, 0.0)) == (200, "")


def test_one_of_two_outputs_counts_by_itself() -> None:
    watched = Watched(samples=SETTLED)
    for _ in range(10):
        assert watched((9.0, 0.0), (1, 0)).done == ""
    assert watched((9.0, 0.0), (1, 0)).done == "inflate"


def test_trust_is_away_for_four_samples_for_each_that_contradicted_and_five_hundred_at_most() -> None:
    once, thrice, always = (Watched(samples=40, gate=1e6) for _ in range(3))
    assert once((6.0, 0.0)).status == CODE.inconsistent  # within the gate, beyond chance
    assert set(once.calm(50)) == {CODE.estimating}
    for _ in range(3):
        thrice((6.0, 0.0))
    for _ in range(300):
        always((6.0, 0.0))
    # The tests of the last few samples go on contradicting for at most 60 samples.
    for watched, least, most in ((thrice, 3 * 4 - 4, 64 * 4), (always, 500 - 4, 500 + 60)):
        later = watched.calm(800)
        away = later.index(CODE.estimating)
        assert least <= away <= most and set(later[away:]) == {CODE.estimating}


def test_what_was_trusted_and_started_again_is_settling_until_sixty_samples_are_known() -> None:
    """What never was settles for four."""
    for samples, away in ((100, 60), (SETTLED, SETTLED)):
        watched = Watched(samples=samples)
        assert until(watched, (40.0, 0.0)) == (10, "inflate")
        later = watched.calm(100)
        assert later.index(CODE.estimating) == away and set(later[away:]) == {CODE.estimating}
        assert later[away - 1] == CODE.settling


def test_after_a_restart_of_a_papers_design_it_is_away_for_a_thousand() -> None:
    watched = Watched(weighted=True, samples=SETTLED)
    assert until(watched, (40.0, 0.0)) == (10, "inflate")
    later = watched.calm(1100)
    assert later.index(CODE.estimating) == 1000 - 4 - 1 and set(later[:SETTLED]) == {CODE.inconsistent}


@pytest.mark.parametrize("size", [0.2, 3.0])
def test_the_deviations_are_in_the_scale_of_the_innovations_where_nobody_says_what_the_noise_is(size: float) -> None:
    """Of 30 samples of `size` deviations: so many times the filter's own; a missing one of two outputs changes nothing."""
    watched = Watched(known=False)
    for k in range(30):
        said = watched(size * np.array([1.0, -1.0]) * (-1) ** k, (1, k % 3 > 0))
        np.testing.assert_allclose(said.factor, size, rtol=5e-15)
        watched((9.0, 9.0), (0, 0))
    np.testing.assert_allclose(watched((9.0, 9.0), (0, 0)).factor, size, rtol=5e-15)


def test_the_scale_is_that_of_the_first_thirty_samples_the_later_ones_most_and_hardly_grows_while_samples_contradict() -> (
    None
):
    """Weights (k + 1)(k + 2) of their squares; nine outliers in a row then add a tenth, where they are ten thousand times as large."""
    watched, sizes, weights = Watched(known=False), [], []
    for k in range(30):
        sizes.append(3.0 if k < 10 else 1.0 + 0.01 * k)
        weights.append((k + 1) * (k + 2))
        said = watched(sizes[-1] * np.array([1.0, -1.0]) * (-1) ** k)
        expected = np.sqrt(np.average(np.square(sizes), weights=weights))
        np.testing.assert_allclose(said.factor, expected, rtol=2e-15)
    for _ in range(9):
        said = watched((1e4, 1e4))
        assert said.outlying == [1, 1]
    assert (said.factor >= expected).all() and (said.factor < 1.1 * expected).all()


@pytest.mark.parametrize("begun", [1, 12, 40])
def test_a_scale_learned_from_a_start_that_went_wrong_is_learned_again(begun: int) -> None:
    """After `begun` absurd samples sixteen that are far quieter; thirty later the deviations are in their scale, a third."""
    watched = Watched(known=False)
    for _ in range(begun):
        watched((1e6, 1e6))
    watched.calm(16 + 30)
    np.testing.assert_allclose(watched((1 / 3, -1 / 3)).factor, 1 / 3, rtol=0.05)


def test_samples_that_grow_ever_quieter_are_no_reason_to_learn_again() -> None:
    """Those of a sensor without noise do, while the estimate converges."""
    watched = Watched(known=False)
    said = [watched(np.array([1, -1]) * 0.7**k).status for k in range(90)]
    assert CODE.settling not in said[30:]


def test_a_scale_that_was_right_for_long_is_not_learned_again() -> None:
    """A sensor that is stuck is quiet, too."""
    watched = Watched(known=False, samples=100)
    before = watched((1 / 3, -1 / 3)).factor
    for _ in range(30):
        after = watched((0.0, 0.0))
    assert after.status != CODE.settling
    np.testing.assert_array_less(0.7 * before, after.factor)


def test_deviations_of_a_given_noise_are_the_filters_own() -> None:
    watched = Watched()
    for k in range(60):
        np.testing.assert_array_equal(watched(3 * np.array([1.0, -1.0]) * (-1) ** k).factor, 1)


def test_of_a_papers_design_the_first_covariance_comes_again_in_the_scale_of_the_start() -> None:
    """Innovations of 3 deviations at first: 9 times the variance. Later they are small, and the scale has come down."""
    for weighted, factor in ((True, 9.0), (False, 1.0)):
        watched = Watched(known=False, weighted=weighted)
        for k in range(600):
            size = 3.0 if k < 30 else 0.3
            said = watched(size * np.array([1.0, -1.0]) * (-1) ** k)
        np.testing.assert_allclose(
            said.again * said.factor[0] ** 2, factor if weighted else said.factor[0] ** 2, rtol=2e-15
        )
        assert said.factor[0] < 0.5


@pytest.mark.parametrize("part", [0.99, 1.01])
def test_the_status_is_by_severity(part: float) -> None:
    """Of what is true of a sample the gravest: a missing output, an outlier, a deviation beyond its limit, a failed correction."""
    tuning = SimpleNamespace(deviation_limit=0.3)
    kept = SimpleNamespace(cases=((1, CODE.outlier),))
    for v, finite, deviations, expected in (
        ((1, 1), 1, (0, 0), CODE.outlier),
        ((0, 1), 1, (0, 0), CODE.sample_rejected),
        ((0, 1), 1, (0.6 * part, 0), CODE.uncertain if part > 1 else CODE.sample_rejected),
        ((1, 1), 1, (0, 1.5 * part), CODE.uncertain if part > 1 else CODE.outlier),
        ((1, 1), 0, (9, 9), CODE.solver_failed),
    ):
        found = status_of(kept, ca.DM(v), ca.DM(finite), ca.DM(deviations), tuning, MODEL.states)  # type: ignore[arg-type]
        assert float(found) == expected
