"""The benchmark runner, on solvers whose order, speed and failures are known; and the rod cases' references."""

from __future__ import annotations

import json
from itertools import count

import numpy as np
import pytest

from plait.pipeline import bench
from plait.pipeline.benchmarks import rods
from plait.pipeline.benchmarks.case import Case, Known, Ladder, Outcome, Richardson, Trial, Variant
from plait.pipeline.benchmarks.runner import FEWEST, LONG, REPEATS, measure, step_count
from plait.pipeline.errors import EXIT_DONE, EXIT_FAILED, UsageError

HARDWARE = ("cpu", 1)
EXACT = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
COARSE = Variant(segments=8, substeps=1, tolerance=1e-8)


class Clock:
    """Tells a time that passes only while a toy solver 'runs'."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def toy(order: float, *, clock: Clock | None = None, fail=lambda variant: None, **changed) -> Case:
    """Error (1, 0, 0) substeps^-order in each row; takes 0.1 substeps seconds, 5 more the first time of all."""
    clock = clock or Clock()
    calls = count()

    def prepare(variant, hardware):
        def run():
            fail(variant)
            clock.now += 0.1 * variant.substeps + (5.0 if next(calls) == 0 else 0.0)
            error = np.array([1.0, 0.0, 0.0]) * variant.substeps**-order
            return Outcome(EXACT + error, {"iterations": 2.0})

        return Trial(run)

    variants = tuple(COARSE._replace(substeps=n) for n in (1, 2, 4, 8))
    fields = {
        "name": "toy",
        "description": "a toy",
        "measure": "rms",
        "scale": 10.0,
        "prepare": prepare,
        "reference": Known(EXACT, "made up"),
        "ladders": (Ladder("time", variants, nominal_order=order),),
        "interval": 1.0,
    }
    return Case(**(fields | changed))


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
def test_errors_and_orders_are_those_of_the_solver(order):
    """Rows differ from the reference by |(1, 0, 0)| n^-p: the relative error is n^-p / scale, the order p."""
    result = measure(toy(order), HARDWARE)
    assert [row.error for row in result.rows] == pytest.approx([n**-order / 10.0 for n in (1, 2, 4, 8)])
    assert result.orders[0].observed == pytest.approx((order, order))
    assert not result.failed


def test_seconds_are_the_median_of_warm_runs_and_the_first_run_is_apart():
    """A run takes 0.1 n; compiling took 5 s, once, and counts in no median."""
    clock = Clock()
    result = measure(toy(1.0, clock=clock), HARDWARE, clock=clock)
    assert [row.seconds for row in result.rows] == pytest.approx([0.1, 0.2, 0.4, 0.8])
    assert [row.first_seconds for row in result.rows] == pytest.approx([5.0, 0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(("seconds", "runs"), [(0.01 * LONG, REPEATS), (LONG, FEWEST)])
def test_what_takes_long_is_run_less_often(seconds, runs):
    clock = Clock()

    def prepare(variant, hardware):
        def run():
            clock.now += seconds
            return Outcome(EXACT, {})

        return Trial(run)

    case = toy(1.0, prepare=prepare, ladders=(Ladder("one", (COARSE,)),))
    assert len(measure(case, HARDWARE, clock=clock).rows[0].runs) == runs


def test_a_variant_of_the_reference_is_warmed_up_by_that():
    """Of 1, 2, 4, 8 substeps, and 2, 4, 8 for the reference, each runs once before it is measured."""
    ran = []
    levels = tuple(COARSE._replace(substeps=n) for n in (2, 4, 8))
    case = toy(2.0, fail=lambda variant: ran.append(variant.substeps), reference=Richardson(levels, 2.0))
    measure(case, HARDWARE, clock=Clock())
    assert [ran.count(n) for n in (1, 2, 4, 8)] == [1 + REPEATS] * 4


def test_one_slow_run_does_not_move_the_median():
    clock, calls = Clock(), count()

    def prepare(variant, hardware):
        def run():
            clock.now += 100.0 if next(calls) == 2 else 1.0
            return Outcome(EXACT, {})

        return Trial(run)

    case = toy(1.0, prepare=prepare, ladders=(Ladder("one", (COARSE,)),))
    assert measure(case, HARDWARE, clock=clock).rows[0].seconds == 1.0


def test_time_to_an_error_is_that_of_the_fastest_row_that_reaches_it():
    """Order 2: errors 10, 2.5, .625, .156 % in .1, .2, .4, .8 s: 1 % takes .4 s, .1 % is not reached."""
    clock = Clock()
    result = measure(toy(2.0, clock=clock), HARDWARE, clock=clock)
    assert result.time_to[1e-2].seconds == pytest.approx(0.4)
    assert result.time_to[1e-3] is None


def test_the_front_holds_what_nothing_beats_in_both():
    """A rung that costs as much as n = 8 but errs as n = 1 is off the front; all others are on it."""
    clock = Clock()

    def prepare(variant, hardware):
        def run():
            clock.now += 8.0 if variant.segments == 9 else variant.substeps
            return Outcome(EXACT + (1.0 if variant.segments == 9 else 1.0 / variant.substeps), {})

        return Trial(run)

    plain = tuple(COARSE._replace(substeps=n) for n in (1, 2, 4, 8))
    wasteful = COARSE._replace(segments=9)
    case = toy(1.0, prepare=prepare, ladders=(Ladder("all", (*plain, wasteful)),))
    rows = measure(case, HARDWARE, clock=clock).rows
    assert [row.front for row in rows] == [True, True, True, True, False]


def test_richardson_finds_the_exact_value():
    """Extrapolating u_h + C h^2 from three levels leaves nothing of the error."""
    levels = tuple(COARSE._replace(substeps=n) for n in (16, 32, 64))
    result = measure(toy(2.0, reference=Richardson(levels, nominal_order=2.0)), HARDWARE)
    assert result.reference_order == pytest.approx(2.0)
    assert [row.error for row in result.rows] == pytest.approx([n**-2 / 10.0 for n in (1, 2, 4, 8)])


@pytest.mark.parametrize(("order", "stands"), [(1.81, True), (2.19, True), (1.79, False), (2.21, False)])
def test_a_reference_off_its_order_is_a_failure(order, stands):
    """The observed order must lie within .2 of the nominal 2."""
    levels = tuple(COARSE._replace(substeps=n) for n in (16, 32, 64))
    result = measure(toy(order, reference=Richardson(levels, nominal_order=2.0)), HARDWARE)
    assert result.failed != stands
    assert len(result.rows) == 4


def refuse_finest(variant):
    if variant.substeps == 8:
        raise ArithmeticError("went wrong")


def test_a_failed_variant_keeps_a_row_of_its_own():
    result = measure(toy(1.0, fail=refuse_finest), HARDWARE)
    assert len(result.rows) == 4
    assert "went wrong" in result.rows[3].failure
    assert result.rows[3].error is None and result.rows[3].seconds is None
    assert result.failed


def test_what_did_not_converge_is_on_no_front_however_right_and_fast():
    def prepare(variant, hardware):
        return Trial(lambda: Outcome(EXACT, {}, "did not converge" if variant.substeps == 8 else ""))

    result = measure(toy(1.0, prepare=prepare), HARDWARE)
    assert result.rows[3].error == 0.0 and result.rows[3].failure == "did not converge"
    assert not result.rows[3].front
    assert result.time_to[1e-3].variant.substeps != 8


def test_a_result_that_is_not_finite_is_a_failure():
    def prepare(variant, hardware):
        return Trial(lambda: Outcome(np.full_like(EXACT, np.nan), {}))

    assert all("not finite" in row.failure for row in measure(toy(1.0, prepare=prepare), HARDWARE).rows)


def test_a_trial_is_closed_also_when_it_fails():
    opened, closed = count(), count()

    def prepare(variant, hardware):
        next(opened)

        def run():
            raise ArithmeticError

        return Trial(run, lambda: next(closed))

    measure(toy(1.0, prepare=prepare), HARDWARE)
    assert next(opened) == next(closed) > 0


def test_progress_is_told_as_often_as_announced():
    told = []
    levels = tuple(COARSE._replace(substeps=n) for n in (16, 32, 64))
    case = toy(1.0, reference=Richardson(levels, nominal_order=1.0))
    measure(case, HARDWARE, step_done=told.append)
    assert len(told) == step_count(case) == 7


def test_json_holds_every_row_and_the_exit_code_tells_of_failures(capsys):
    """Failures are data too, and what is not a number becomes null, so that any reader takes it."""
    good = toy(2.0, interval=np.float64(0.5))
    bad = toy(2.0, fail=refuse_finest, name="bad")
    assert bench.show([], as_json=True, available=(good,)) == EXIT_DONE
    capsys.readouterr()
    assert bench.show([], as_json=True, available=(good, bad)) == EXIT_FAILED
    data = json.loads(capsys.readouterr().out)
    assert [case["name"] for case in data["cases"]] == ["toy", "bad"]
    assert [len(case["rows"]) for case in data["cases"]] == [4, 4]
    assert data["cases"][0]["rows"][1]["step"] == 0.25
    assert "went wrong" in data["cases"][1]["rows"][3]["failure"]
    assert data["cases"][1]["orders"][0]["observed"][1] is None
    assert data["versions"]["plait"]


def test_the_table_shows_failures_and_the_plot_is_a_picture(capsys, tmp_path):
    picture = tmp_path / "errors.png"
    bench.show([], plot=picture, available=(toy(2.0, fail=refuse_finest),))
    text = capsys.readouterr().out
    assert "FAILED" in text and "went wrong" in text
    assert "time to 1.0%" in text and "not reached" in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_case_with_no_error_is_in_the_plot_too(tmp_path):
    """Nought has no place on a logarithmic axis: cases in which every row is exact, or fails, are named there."""
    exact = toy(2.0, name="exact", prepare=lambda variant, hardware: Trial(lambda: Outcome(EXACT, {})))
    fails = toy(2.0, name="fails", fail=lambda variant: refuse_finest(variant._replace(substeps=8)))
    picture = tmp_path / "errors.svg"
    bench.show([], plot=picture, available=(toy(2.0), exact, fails))
    assert picture.read_text().count("no row with an error above 0") == 2


@pytest.mark.parametrize(
    "wrong",
    [{"cases": ["nonsense"]}, {"cases": [], "device": "cuda:99"}, {"cases": [], "plot": "errors.doc"}],
    ids=lambda wrong: list(wrong)[-1],
)
def test_what_cannot_be_measured_is_said_before_measuring(wrong, tmp_path):
    if "plot" in wrong:
        wrong["plot"] = tmp_path / wrong["plot"]
    with pytest.raises(UsageError):
        bench.show(**wrong, available=(toy(1.0),))


def test_every_case_is_listed(capsys):
    assert bench.show([], list_only=True) == EXIT_DONE
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == [
        "heavy-cantilever",
        "bend-45",
        "released-cantilever",
        "shaken-hair",
        "bar-bending",
        "bar-ringing",
        "capstan",
        "tubes",
        "crossing",
    ]


@pytest.mark.parametrize("case", rods.CASES, ids=lambda case: case.name)
def test_ladders_with_an_order_double_from_rung_to_rung(case):
    """Observed orders are logarithms to base 2 of ratios: each rung must be twice as fine as the one before."""
    for ladder in case.ladders:
        if ladder.nominal_order is not None:
            for coarse, fine in zip(ladder.variants, ladder.variants[1:], strict=False):
                changed = {name: (a, b) for name, a, b in zip(fine._fields, coarse, fine, strict=True) if a != b}
                assert changed.keys() <= {"segments", "substeps"} and changed
                assert all(b == 2 * a for a, b in changed.values())


# The references of the rod cases, solved here by other means ----------------------------------------------------


def heavy_elastica_tip(gamma: float, slenderness: float) -> np.ndarray:
    """EI theta'' = -(1 + N/EA) q (L - s) cos theta, theta(0) = theta'(L) = 0, N = q (L - s) sin theta; q = L = 1.

    slenderness: EA / (q L). Shooting on the curvature at the clamp.
    """
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def rates(s, y):
        theta, curvature = y[:2]
        stretch = 1.0 + (1.0 - s) * np.sin(theta) / slenderness
        x, y = stretch * np.cos(theta), -stretch * np.sin(theta)
        return [curvature, -gamma * (1.0 - s) * x, x, y]

    def tip(curvature):
        return solve_ivp(rates, (0, 1), [0, curvature, 0, 0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]

    return tip(brentq(lambda curvature: tip(curvature)[1], 1e-3, 10.0, xtol=1e-13))[2:]


def bent_tip(force: float, EA: float, GA: float) -> np.ndarray:
    """Tip of a 45 degree arc, R = 100, EI = GJ = 1e7 / 12, from +y towards +x, dead force along z at its end.

    r' = R v, v = (n1/GA, n2/GA, 1 + n3/EA), m' = n x r', kappa = kappa_0 + m / EI in the directors' frame;
    shooting on the moment at the clamp so that none is left at the tip.
    """
    from scipy.integrate import solve_ivp
    from scipy.optimize import fsolve

    radius, stiffness = 100.0, 1e7 / 12.0
    clamp = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns: directors, tangent last

    def end(moment, load):
        n = np.array([0.0, 0.0, load])

        def rates(s, y):
            frame, m = y[3:12].reshape(3, 3), y[12:]
            force_here = frame.T @ n
            v = np.array([force_here[0] / GA, force_here[1] / GA, 1.0 + force_here[2] / EA])
            k = frame.T @ m / stiffness + np.array([0.0, 1.0 / radius, 0.0])
            spin = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
            tangent = frame @ v
            return np.concatenate([tangent, (frame @ spin).ravel(), -np.cross(tangent, n)])

        start = np.concatenate([np.zeros(3), clamp.ravel(), 1e4 * moment])
        return solve_ivp(rates, (0, radius * np.pi / 4), start, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]

    moment = np.zeros(3)
    for load in np.linspace(force / 4, force, 4):
        moment = fsolve(lambda m, load=load: end(m, load)[12:] / 1e4, moment, xtol=1e-11)
    return end(moment, force)[:3]


def test_heavy_cantilever_reference(shared):
    """The same solve gives the table's inextensible value, and, with the case's EA, the case's."""
    table = np.genfromtxt(shared / "references/heavy_elastica_cantilever.csv", delimiter=",", skip_header=1)
    row = table[table[:, 0] == rods.HEAVY_GAMMA][0]
    fibre = rods.cantilever_fibre(rods.HEAVY_GAMMA)
    slenderness = fibre.stretch_stiffness / (fibre.density * fibre.area * rods.GRAVITY)
    assert heavy_elastica_tip(rods.HEAVY_GAMMA, np.inf) == pytest.approx([row[2], -row[1]], rel=1e-9)
    assert heavy_elastica_tip(rods.HEAVY_GAMMA, slenderness) == pytest.approx(rods.HEAVY_TIP[:2], rel=1e-9)


def test_bend_reference(shared):
    """One solve gives the table's Kirchhoff and Simo-Reissner values; extensible but without shear, the case's.

    The case is drawn with x and y exchanged.
    """
    table = np.genfromtxt(shared / "references/bend45_tip.csv", delimiter=",", skip_header=1)
    row = table[table[:, 0] == rods.BEND_FORCE][0]
    assert bent_tip(rods.BEND_FORCE, np.inf, np.inf) == pytest.approx(row[4:7], rel=1e-7)
    assert bent_tip(rods.BEND_FORCE, 1e7, 5e6) == pytest.approx(row[1:4], rel=1e-7)
    assert bent_tip(rods.BEND_FORCE, 1e7, np.inf)[[1, 0, 2]] == pytest.approx(rods.BEND_TIP, rel=1e-7)


def test_released_cantilever_period():
    """cos x cosh x = -1 at x^2 = 3.5160153, the first mode of a clamped rod."""
    root = np.sqrt(3.5160153)
    assert np.cos(root) * np.cosh(root) == pytest.approx(-1.0, abs=1e-6)
