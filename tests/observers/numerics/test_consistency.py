"""The chi-square tests of the innovations: quantiles against scipy, false alarms and detection by ensembles."""

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2, norm

from observers.numerics import consistency


@pytest.mark.parametrize("false_alarm", [1e-6, 1e-4, 1e-2])
def test_quantiles_are_scipys(false_alarm):
    for dof, tolerance in ((1, 0.15), (2, 0.1), (5, 0.05), (60, 0.004)):
        ours = float(ca.DM(ca.evalf(ca.SX(consistency.chi_square_quantile(dof, false_alarm)))))
        assert ours == pytest.approx(chi2.isf(false_alarm, dof), rel=tolerance)
    assert float(ca.evalf(ca.SX(consistency.normal_quantile(false_alarm)))) == pytest.approx(
        norm.isf(false_alarm), abs=4.5e-4
    )


def stepper(ny):
    memory, squared, false_alarm = ca.SX.sym("m", consistency.memory_size(ny)), ca.SX.sym("s"), ca.SX.sym("f")
    normalised, valid = ca.SX.sym("n", ny), ca.SX.sym("v", ny)
    found = consistency.tested(memory, squared, normalised, valid, false_alarm)
    function = ca.Function(
        "t", [memory, squared, normalised, valid, false_alarm], [found.memory, found.alone, found.lately]
    )

    def run(innovations, false_alarm, valid=None):
        state, raised = np.zeros(consistency.memory_size(ny)), []
        for k, e in enumerate(innovations):
            there = np.ones(ny) if valid is None else valid[k]
            shown = np.where(there, e, 0.0)
            state, alone, lately = function(state, shown @ shown, shown, there, false_alarm)
            raised.append((float(alone), float(lately)))
        return np.array(raised)

    return run


@pytest.mark.parametrize("ny", [1, 2])
def test_white_innovations_raise_about_as_often_as_said(ny):
    rng = np.random.default_rng(1)
    raised = stepper(ny)(rng.standard_normal((20_000, ny)), 1e-3)
    assert 0.3e-3 < raised[:, 0].mean() < 1.5e-3
    assert (
        raised[:, 1].mean() < 1e-3 * 3 * (1 + ny) * 2
    )  # three windows, a sum and ny biases each, twice the probability


def test_half_the_samples_missing_raise_no_more():
    rng = np.random.default_rng(2)
    raised = stepper(1)(rng.standard_normal((20_000, 1)), 1e-3, rng.random((20_000, 1)) < 0.5)
    assert raised[:, 0].mean() < 1.5e-3 and raised[:, 1].mean() < 12e-3


@pytest.mark.parametrize(
    ("name", "disturb"),
    [
        ("five times the noise", lambda e: 5 * e),
        ("an offset of one deviation", lambda e: e + 1.0),
        ("a drift", lambda e: e + 0.02 * np.arange(len(e))[:, None]),
        ("not finite", lambda e: e * np.nan),
    ],
)
def test_what_is_wrong_is_found_within_sixty_samples_and_forgotten_within_two_hundred(name, disturb):
    rng = np.random.default_rng(3)
    clean = rng.standard_normal((600, 1))
    innovations = clean.copy()
    innovations[300:400] = disturb(clean[300:400])
    raised = stepper(1)(innovations, 1e-4).any(axis=1)
    assert not raised[:300].any(), name
    assert raised[300:400].any() and np.flatnonzero(raised)[0] < 360, name
    assert not raised[-1], name


def test_one_absurd_sample_is_forgotten_at_once():
    innovations = np.random.default_rng(4).standard_normal((200, 1))
    innovations[100] = 1e9
    raised = stepper(1)(innovations, 1e-4)
    assert list(np.flatnonzero(raised[:, 0])) == [100] and np.flatnonzero(raised[:, 1]).size <= 3


@pytest.mark.parametrize("scale", [1.2, 2.0, 3.0])
def test_the_last_samples_are_weighed_as_satterthwaite_says(scale):
    """Over 300 samples of two outputs, a third of them missing: numpy's sums of all the past, scipy's quantiles."""
    rng, false_alarm, ages = np.random.default_rng(7), 1e-2, np.arange(300)[::-1]
    innovations, valid = scale * rng.normal(size=(300, 2)), rng.random((300, 2)) > 0.3
    raised = stepper(2)(innovations, false_alarm, valid)
    shown = np.where(valid, innovations, 0)
    squared, dof = np.sum(shown**2, axis=1), valid.sum(axis=1)
    limits, bound = chi2.isf(false_alarm, np.maximum(dof, 1)), np.sqrt(chi2.isf(false_alarm, 1))
    near, compared = 0.02, []
    for k in range(300):
        expected, clear = False, True
        for n in consistency.WINDOWS:
            weight = ((n - 1) / (n + 1)) ** ages[-k - 1 :]
            D1, D2 = weight @ dof[: k + 1], weight**2 @ dof[: k + 1]
            if D1 <= 1:
                continue
            total = weight @ np.minimum(squared, limits)[: k + 1]
            ratios = [total * D1 / (D2 * chi2.isf(false_alarm, D1**2 / D2))]
            for i in range(2):
                sums = weight @ np.clip(shown[: k + 1, i], -bound, bound)
                ratios.append(sums**2 / max(weight**2 @ valid[: k + 1, i] * bound**2, 1e-30))
            expected |= max(ratios) > 1
            clear &= not any(abs(ratio - 1) < near for ratio in ratios)
        if clear:
            compared.append((expected, raised[k, 1]))
    found = np.array(compared)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    assert len(found) > 250 and found[:, 0].sum() > 0
    np.testing.assert_array_equal(
        raised[np.abs(squared / limits - 1) > near, 0], (squared > limits)[np.abs(squared / limits - 1) > near]
    )
