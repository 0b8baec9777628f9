import numpy as np
import pytest

from lbacal_core.calibration.slow_changes import SlowChange, follow_slow_changes
from lbacal_core.calibration.spreads import serve_reference
from lbacal_core.curves.covariance import CurveCovariance
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.grids import YEAR_S

MHZ = np.array([30.0, 55.0, 80.0])
YEAR = (0.0, YEAR_S)
CURVE = CalibrationCurve(
    station="CS002", antenna=1, dipole="X", status="converged", events=100, frequency_mhz=MHZ, c=np.ones(3),
    c_sigma_stat=np.full(3, 0.01), c_sigma_sys=np.full(3, 0.03), chi2_per_dof=1.0, lst_coverage=1.0, parameters={},
    covariance=CurveCovariance(np.zeros((0, 3)), np.full(3, 1e-4), None, np.full((1, 3), 0.03)),
)  # fmt: skip


def test_a_ramp_is_told_beside_its_mean_over_the_events_of_the_fit():
    ramp = SlowChange(False, 0.0, 0.0, 0.1, 0.02, (0.04, 0.0))
    served = follow_slow_changes(serve_reference(CURVE), [ramp], YEAR_S, YEAR)
    assert served.factor == pytest.approx(np.exp([0.03, 0.05, 0.07]), rel=1e-3)
    assert served.error == pytest.approx(0.01, rel=1e-3)
    assert served.curve.c == pytest.approx(served.factor)
    assert served.curve.c_sigma_sys / served.curve.c == pytest.approx(np.hypot(0.03, 0.01), rel=1e-3)
    assert np.sqrt(np.sum(served.curve.covariance.own**2, axis=0)) == pytest.approx(np.hypot(0.03, 0.01), rel=1e-3)
    assert served.curve.c_sigma_stat / served.curve.c == pytest.approx(0.01)
    later = SlowChange(False, 2.0 * YEAR_S, 0.0, 0.1, 0.02, (0.0, 0.0))
    assert follow_slow_changes(serve_reference(CURVE), [later], YEAR_S, YEAR).factor == pytest.approx(1.0)


def test_a_season_is_largest_at_its_date_and_its_date_has_an_error():
    season = SlowChange(True, 5.25 * YEAR_S, 0.02 * YEAR_S, 0.1, 0.0, (0.0, 0.0))
    at = [follow_slow_changes(serve_reference(CURVE), [season], part * YEAR_S, YEAR) for part in (0.25, 0.5, 0.75)]
    assert [one.factor[0] for one in at] == pytest.approx(np.exp([0.1, 0.0, -0.1]), rel=1e-3)
    assert [one.error for one in at] == pytest.approx([0.0, 0.1 * 2.0 * np.pi * 0.02, 0.0], rel=0.01, abs=1e-3)
