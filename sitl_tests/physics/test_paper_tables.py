"""Tables 1 to 4 of the paper, held to closed forms written here and to the printed precision."""

from __future__ import annotations

import math

import pytest

from companion.paper import beam_tables, printed, range_tables


def frequency_equation(x: float, mu: float) -> float:
    """Inman's cantilever with a tip mass, written out again."""
    return 1 + math.cos(x) * math.cosh(x) + mu * x * (math.cos(x) * math.sinh(x) - math.sin(x) * math.cosh(x))


def bisected(mu: float, low: float, high: float) -> float:
    for _ in range(200):
        middle = 0.5 * (low + high)
        if frequency_equation(low, mu) * frequency_equation(middle, mu) <= 0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@pytest.mark.parametrize(("mode", "ratio"), [(0, 2.260), (1, 2.389), (2, 2.329)])
def test_each_printed_root_implies_its_own_tip_mass(mode: int, ratio: float) -> None:
    root = printed.MODES[mode].root
    mass_ratio = beam_tables.implied_mass_ratio(root)
    assert mass_ratio == pytest.approx(ratio, abs=5e-4)
    assert frequency_equation(root, mass_ratio) == pytest.approx(0.0, abs=1e-6 * math.cosh(root))


def test_the_best_fit_is_the_audited_one_and_omega_1_belongs_to_another_root() -> None:
    ratio, scale, left = beam_tables.best_fit()
    assert ratio == pytest.approx(2.389, abs=5e-4)
    assert scale == pytest.approx(118.156, abs=1e-3)
    assert max(abs(left)) < 2e-4
    root = math.sqrt(printed.MODES[0].omega_radps / scale)
    assert round(root, 3) == 1.034
    assert root == pytest.approx(bisected(ratio, 0.5, 2.0), rel=1e-4)


def test_the_strip_is_one_strip() -> None:
    beam = beam_tables.corrected_beam()
    assert beam.area_m2 == pytest.approx(5.07e-5, rel=1e-12)
    assert beam.second_moment_m4 == pytest.approx(4.225e-12, rel=1e-12)


@pytest.mark.parametrize(
    ("tip_kg", "percents"), [(0.0365, (0.02, 0.07, 0.05)), (0.035, (1.94, 0.17, 0.08))], ids=["repaired", "as printed"]
)
def test_the_strip_gives_the_printed_frequencies(tip_kg: float, percents: tuple[float, ...]) -> None:
    scale = math.sqrt(70e9 * 0.0507 * 0.001**3 / 12 / (2700 * 0.0507 * 0.001)) / 0.1115**2
    mu = tip_kg / (2700 * 0.0507 * 0.001 * 0.1115)
    brackets = ((0.5, 2.0), (3.5, 4.5), (6.5, 7.5))
    modes = beam_tables.corrected_beam(tip_kg).modes(3)
    for mode, bracket, row, percent in zip(modes, brackets, printed.MODES, percents, strict=True):
        omega = bisected(mu, *bracket) ** 2 * scale
        assert mode.omega_radps == pytest.approx(omega, rel=1e-9)
        assert abs(100 * (omega / row.omega_radps - 1)) == pytest.approx(percent, abs=0.006)


def test_no_power_of_ten_repairs_table_1() -> None:
    worst, _, _ = beam_tables.powers_of_ten()
    assert worst > 0.1


def test_hertz_do_not_follow_from_radians() -> None:
    hertz = printed.MODES[0].omega_radps / (2 * math.pi)
    assert f"{hertz:.3f}" == "20.102"
    assert f"{hertz:.4f}" != f"{printed.MODES[0].frequency_hz:.4f}"


@pytest.mark.parametrize(("row", "toe_mrad", "left_mrad"), [(0, 4.478, -0.824), (1, 5.370, 0.946), (2, 5.818, 0.0)])
def test_table_3_implies_these_angles(row: int, toe_mrad: float, left_mrad: float) -> None:
    entry = range_tables.objects()[row]
    assert 1e3 * entry["toe_rad"] == pytest.approx(toe_mrad, abs=6e-4)
    assert 1e3 * entry["left_rad"] == pytest.approx(left_mrad, abs=6e-4)
    table = printed.OBJECTS[row]
    assert range_tables.read_range_m(table.still_m, entry["toe_rad"]) == pytest.approx(table.vibrating_m, rel=1e-12)


def test_percentages_are_truncated_not_rounded() -> None:
    rows = range_tables.objects()
    for entry, row in zip(rows, printed.OBJECTS, strict=True):
        assert entry["error_percent_truncated"] == pytest.approx(row.error_percent, abs=1e-9)
    assert round(rows[0]["error_percent"], 2) != printed.OBJECTS[0].error_percent
    assert rows[1]["left_percent_truncated"] == pytest.approx(0.19)


def test_no_single_angle_gives_all_three_rows() -> None:
    _, misfit_m = range_tables.one_angle()
    assert max(abs(misfit_m)) > 5 * 0.0005 * 2


def test_what_table_4_follows_from() -> None:
    far = range_tables.far()
    assert round(far["vibrating_m"], 1) == printed.FAR_VIBRATING_M
    assert f"{far['corrected_by_half_m']:.2f}" == "56.85"
    assert abs(far["corrected_by_tables_residual_m"] - printed.FAR_CORRECTED_M) > 4.0
    assert 100 * far["range_error_removed"] == pytest.approx(55.56, abs=5e-3)


def test_the_wide_factor_is_what_two_turned_pinholes_see() -> None:
    depth, half, turn, f = 4.096, 0.99, 1e-6, 800.0
    slope = math.atan2(half, depth)  # under which each camera sees the object
    still, turned = 2 * f * math.tan(slope), 2 * f * math.tan(slope + turn)
    assert (turned - still) / (f * 2 * turn) == pytest.approx(range_tables.wide_factor(depth), rel=1e-5)
