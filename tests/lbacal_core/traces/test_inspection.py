"""The drawing of one trace and of what cleaning did to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lbacal_core.traces.background import CleaningSettings, measure_traces
from lbacal_core.traces.inspection import draw_inspection
from lbacal_core.traces.trace import Trace
from lbacal_twin.voltages import Transmitter


def test_a_trace_is_drawn_with_its_whole_band_what_was_left_out_and_the_result(
    make_trace: Callable[..., Trace],
) -> None:
    settings = CleaningSettings()
    trace = make_trace(3, blocks=200, disturbances=[Transmitter(45.03, 5.0)])
    (found,) = measure_traces([trace], settings, is_station=False)
    figure = draw_inspection(trace, found, settings)
    top, middle, bottom = figure.axes
    assert figure.get_suptitle() == f"simulated.dat: {trace.reference.name}, 200 blocks"
    assert top.get_title() == "blocks dropped: none"
    labels = [(one.get_xlabel(), one.get_ylabel()) for one in figure.axes]
    of_power = "frequency (MHz)", "power (ADC²/Ω/MHz)"
    assert labels == [("time since the first sample (ms)", "ADC units"), of_power, of_power]
    assert [[text.get_text() for text in one.get_legend().get_texts()] for one in figure.axes] == [
        ["range", "mean ± r.m.s. of a block"],
        ["before: all blocks, channels of 0.195 MHz", "channels left out"],
        ["clean channels", "left out", "result with its radiometer noise", "filled bins"],
    ]
    # samples of 5 ns: 200 blocks of 1024 last a millisecond, and reach 100 MHz
    np.testing.assert_allclose(top.lines[0].get_xdata()[[0, -1]], [0.0, 199 * 1024 * 5e-6])
    whole, lost = middle.lines
    assert (middle.get_xlim(), bottom.get_xlim()) == ((0.0, 100.0), (29.0, 81.0))
    assert (whole.get_xdata()[0], whole.get_xdata()[-1]) == (0.0, 100.0)
    assert np.all(np.abs(lost.get_xdata() - 45.03) < 0.5)
    _, left_out, result, filled = bottom.lines
    np.testing.assert_array_equal(left_out.get_xdata(), lost.get_xdata())
    np.testing.assert_array_equal(result.get_xdata(), settings.frequency_mhz)
    np.testing.assert_array_equal(result.get_ydata(), found.power)
    assert filled.get_xdata().size == 0
    # 4 ADC^2/MHz over 50 Ohm, of some 1000 averages a bin, lies in the drawing as white noise does
    assert bottom.get_ylim()[0] < 0.08 < bottom.get_ylim()[1]
