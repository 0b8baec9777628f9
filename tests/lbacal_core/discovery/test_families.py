from __future__ import annotations

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import signature, spectral_signature
from lbacal_core.discovery.families import FamilySpectra, batch_families, list_families


def test_spectral_templates_times_time_profiles_are_the_signatures_of_all_templates(model):
    conditions = model.station.conditions
    for family in list_families(conditions, CAUSES)[::7]:
        for k in (0, -1):
            template = family.templates[k]
            base = signature(family.cause, model.terms, conditions, family.templates[0])
            profile = family.cause.time_profile(conditions, template)
            first = family.cause.time_profile(conditions, family.templates[0])
            both = (profile[:, 0] != 0) & (first[:, 0] != 0)
            direct = signature(family.cause, model.terms, conditions, template)
            expected = base[:, both] / first[both] * profile[both]
            np.testing.assert_allclose(direct[:, both], expected, rtol=2e-3, atol=2e-5 * np.abs(direct).max())


def test_lines_are_one_spectrum_times_factors_and_are_the_signatures_of_each(model):
    conditions = model.station.conditions
    families = list_families(conditions, [cause for cause in CAUSES if cause.identifier == "rfi_line"])
    (batch,) = batch_families(conditions, families, model.station.power[0].size)
    spectra = FamilySpectra.of(model, batch)
    assert spectra.values.shape[0] == 1
    for k in (0, 7, -1):
        direct = spectral_signature(batch[k].cause, model.terms, conditions, batch[k].templates[0])
        np.testing.assert_allclose(spectra.whole[k], direct, rtol=1e-6, atol=1e-9)
