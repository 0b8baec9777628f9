"""What a path should see at an instant, by the calibration that is then in effect."""

from __future__ import annotations

import json
from dataclasses import dataclass

from lbacal.instants import SECOND_US
from lbacal_core.calibration.one_event import OverLst, compare_over_lst, map_departures
from lbacal_core.calibration.prediction import Prediction
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import parse_budget
from lbacal_core.curves.validity import Instant
from lbacal_core.discovery.forward import predict
from lbacal_core.grids import Floats
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import iterate_blocks
from service.storage.spectra import Window
from service.usecases.calibrations import Calibrations, CurveInEffect, select_paths
from service.usecases.fits import Fits


@dataclass(frozen=True)
class Predictions:
    """Predicts what paths see."""

    calibrations: Calibrations
    simulation: Simulation
    fits: Fits

    def of(
        self, station: str, antenna: int, dipole: str, at: Instant, temperature_c: float | None
    ) -> tuple[CurveInEffect, Prediction]:
        """The curve in effect for a path, and what follows from it."""
        found = self.calibrations.in_effect(at, select_paths(self.simulation.instrument, station, antenna, dipole))
        curve = found.curves[0]
        served = curve.served.curve
        text = None if served.covariance is None else found.budgets.get(str(served.covariance.budget))
        budget = None if text is None else parse_budget(json.loads(text))
        is_own, seconds = curve.promotion.scope.antenna is not None, at / SECOND_US
        model = curve.version.inputs.get("settings", {}).get("model")
        # the causes of the version that answers, at their adopted sizes: those fitted again are not kept with it
        simulation = self.simulation if model is None else self.simulation.with_causes(Model.from_text(model))
        return curve, predict(served, simulation, seconds, budget=budget, temperature_c=temperature_c, is_own=is_own)

    def beside_data(self, curve: CurveInEffect) -> tuple[OverLst, Floats] | None:
        """Data and prediction of a path in its version's window: band power over sidereal time, and the residual map.

        The map is measured over predicted power minus 1, shape (lst, freq). None where there are no spectra.
        """
        version, database = curve.version, self.calibrations.database
        with database.read() as stores:
            window = Window(version.since, version.until, curve.path)
            if not stores.spectra.content(window)[0]:
                return None
            spectra = self.fits.load_window(stores, window, with_covariates=False)
        served = curve.served.curve
        (block,) = iterate_blocks(spectra)
        return compare_over_lst(spectra, served, self.simulation), map_departures(block, [served], self.simulation)
