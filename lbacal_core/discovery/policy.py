"""Every threshold of the search, with its source; it goes into the provenance of a report."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lbacal_core.calibration.chain_form import EXCLUDED, OPEN

JUDGE = "compete"
"""The judge of spectra: a cause is named where no sentence that says something else is likelier by far."""


@dataclass(frozen=True)
class Policy:
    """Thresholds for a finding, for its name, and for residual structure.

    Attributes
    ----------
    catalogue_alpha, antenna_alpha, structure_alpha
        Probability of a false alarm of the scan, of the comparisons of antennas and of cable names, and of the test for
        residual structure; together the false-alarm rate of a station, 1 in 300, a third of the required 1 in 100. A
        name is given by chance in 1.2 of 1000 stations, where 5 are allowed: all that is not noise has the rest.
    most_findings, most_of_station
        Findings on one path, and of a station, after which the search ends: a course without a name would become many
        steps. What is unsaid of one antenna is in the mean to which all are held, and biases the sizes of others.
    rivals
        Candidates that are fitted without linearising before one is named: in ``./dev prove discovery`` the right
        cause was always among the first four.
    rival_share
        Share of the best score below which a candidate cannot win by a better fit.
    indistinguishable
        SNR^2 (1 - r^2) below which another template fits as well: 3 standard deviations.
    beside_share
        Factor on the probability of a false alarm of causes beside a structure: what it leaves of itself is no noise.
    likelier
        ln of the odds by which a cause must be likelier than chance as it fits, and a sentence than the likeliest
        cause: 20 to 1. Three gains along UTC that were named interference had 1.8 to 5.4 in chi^2, right names at ideal
        SNR 4 to 8 have 7.1 and more (spent data sets).
    alike
        Correlation of the templates of a sentence and a cause above which they say the same: the cause is named unless
        the sentence fits better by more than `indistinguishable`. Three true interferences by hours had 0.95 and more,
        of 18 gains along LST and UTC, named falsely, 12 had 0.89 and less, and 5 of the others a chi^2 that is larger
        by 20 to 110 than the sentence's (debug and spent data sets).
    hidden_share
        Share of the information of a cause that free differences between models leave, below which they hide it: it is
        then neither looked for nor named. They leave nothing of a slope of N_LNA and of an isotropic level, and 0.06
        or more of every other cause (12 antennas, 900 events; 4 antennas, 300 events).
    """

    catalogue_alpha: float = 0.001
    antenna_alpha: float = 0.0002
    structure_alpha: float = 0.002
    most_findings: int = 5
    most_of_station: int = 16
    rivals: int = 4
    rival_share: float = 0.6
    indistinguishable: float = 9.0
    beside_share: float = 0.01
    hidden_share: float = 0.03
    likelier: float = 3.0
    alike: float = 0.9

    @property
    def alpha_of_each_comparison(self) -> float:
        """Probability of a false alarm of the comparison of antennas, and as much of that of cable names."""
        return self.antenna_alpha / 2

    def as_dict(self) -> dict[str, Any]:
        """The thresholds by name, for the provenance of a report."""
        return asdict(self) | {"form_open": OPEN, "form_excluded": EXCLUDED}


CURVE_POLICY = Policy(most_findings=4, rivals=3)
"""For an LST curve, whose 91 points distinguish few causes."""
