from __future__ import annotations

import numpy as np

from lbacal_core.chain.model import ChainTerms, chain_power


def test_the_power_of_the_terms_is_the_chain_equation_written_out() -> None:
    rng = np.random.default_rng(11)
    classes, events, channels = 2, 5, 7
    sky = rng.uniform(1.0, 3.0, (classes, events, channels))
    antenna_gain, correction, receiver_gain = rng.uniform(0.5, 2.0, (3, channels))
    cable_loss = rng.uniform(0.1, 0.9, (classes, channels))  # two classes of paths: two lengths of cable
    scale, n_lna, n_rcu, n_adc = 30.0, 0.2, 0.05, 4.0
    terms = ChainTerms(
        sky=sky,
        n_lna=np.array(n_lna),
        front=(antenna_gain * correction * cable_loss * receiver_gain * scale)[:, None, :],
        receiver_noise=n_rcu * scale * receiver_gain,
        adc_noise=np.array(n_adc),
    )
    written_out = [
        chain_power(
            sky[path],
            antenna_gain=antenna_gain,
            correction=correction,
            cable_loss=cable_loss[path],
            receiver_gain=receiver_gain,
            scale=scale,
            n_lna=n_lna,
            n_rcu=n_rcu,
            n_adc=n_adc,
        )
        for path in range(classes)
    ]
    np.testing.assert_allclose(terms.power(), written_out, rtol=1e-13)
