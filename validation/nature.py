"""What `lbacal` says and fits in worlds that are not its own: drawn skies, antennas and noise, 12 antennas, 900 events.

Every data set draws a sky and an antenna that are not the finder's, nor among the models from which it makes its modes;
a third of the skies lies outside every model. Event gains act where they are drawn to. A tenth of the data sets has the
whole station, 48 antennas. No effect is hidden in an antenna that is deaf, or that died before it had the 60
spectra of a fit: a search leaves them out.
Parts: nothing hidden (nothing); pulls of C, the sky told (pulls); one effect of a drawn cause (one); effects on a cable
name or a group (targets); effects in no catalogue (unknown); effects that look like a vector of the noise, at three
sizes (like-noise).
"""

from __future__ import annotations

from validation.hidden import like_noise, named_in_worlds, no_catalogue, nothing, pulls

PARTS = (*nothing.PARTS, *pulls.PARTS, *named_in_worlds.PARTS, *no_catalogue.PARTS_IN_WORLDS, *like_noise.PARTS)
