"""The whole in Python: one verb a file, which the command of its name calls too. Read `result` first, then `fit`.

>>> import lbacal, numpy as np
>>> from astropy import units as u
>>> site = lbacal.Site(latitude=-30.7 * u.deg, longitude=21.4 * u.deg)
>>> antenna = lbacal.Antenna("inverted-v", arms={"E": 90 * u.deg, "N": 0 * u.deg})
>>> instrument = lbacal.Instrument("mine", site, antenna, lbacal.Chain(), np.arange(50, 100) * u.MHz, antennas=3)
>>> spectra = lbacal.simulate(instrument, events=200)
>>> found = lbacal.fit(spectra, instrument)
>>> figure = found.plot()

Units are astropy's here, at the edge; `lbacal_core` behind it has plain numbers with their unit in the name. A number
without a unit is taken in the unit that the argument names.
"""
