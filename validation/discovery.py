"""What `lbacal investigate` finds in simulated stations, against an ideal detector that knows everything.

Parts: nothing hidden (clean; nuisances, as real campaigns have; ten-antennas; own-sky; lst-curves); one effect of a
drawn cause (one); cause by cause (efficiency); cables of one antenna (static); two and three effects (several); effects
in no catalogue (unknown); what was found, removed from unseen events (held-out).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from validation.hidden import clean, held_out, no_catalogue, one_effect, several_effects
from validation.hidden.one_effect import draw_detection
from validation.machinery.parts import Row

PARTS = (*clean.PARTS, *one_effect.PARTS, *several_effects.PARTS, *no_catalogue.PARTS, *held_out.PARTS)
IMAGES = {
    "discovery.png": "Left: probability of detection against the ideal SNR. Right: what each cause keeps of it",
}


def draw(rows: Mapping[str, Sequence[Row]]) -> dict[str, Figure]:
    if not {"one", "efficiency"} <= set(rows):
        return {}
    return {"discovery.png": draw_detection(rows["one"], rows["efficiency"])}
