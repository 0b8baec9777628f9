"""What a path should see at an instant, by the calibration that is then in effect."""

from __future__ import annotations

import json
from dataclasses import dataclass

from lbacal_core.calibration.prediction import Prediction
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import parse_budget
from lbacal_core.curves.validity import Instant
from lbacal_core.discovery.forward import predict
from lbacal_core.simulation.simulation import Simulation
from service.storage.versions import MICROSECONDS
from service.usecases.calibrations import Calibrations, CurveInEffect, select_paths


@dataclass(frozen=True)
class Predictions:
    """Predicts what paths see."""

    calibrations: Calibrations
    simulation: Simulation

    def of(
        self, station: str, antenna: int, dipole: str, at: Instant, temperature_c: float | None
    ) -> tuple[CurveInEffect, Prediction]:
        """The curve in effect for a path, and what follows from it."""
        found = self.calibrations.in_effect(at, select_paths(self.simulation.instrument, station, antenna, dipole))
        curve = found.curves[0]
        told = curve.told.curve
        text = None if told.covariance is None else found.budgets.get(str(told.covariance.budget))
        budget = None if text is None else parse_budget(json.loads(text))
        is_own, seconds = curve.promotion.scope.antenna is not None, at / MICROSECONDS
        model = curve.version.inputs["settings"].get("model")
        # the causes of the version that answers, at their adopted sizes: those fitted again are not kept with it
        simulation = self.simulation if model is None else self.simulation.with_causes(Model.from_text(model))
        return curve, predict(told, simulation, seconds, budget=budget, temperature_c=temperature_c, is_own=is_own)
