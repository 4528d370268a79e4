"""A thinned line looks like the whole one."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from swarmabs_analysis.report.pictures import thin_lines
from swarmabs_bag.recorded_swarm import column_points


def test_every_column_keeps_its_ends_extremes_and_gaps() -> None:
    draw = np.random.default_rng(5)
    column = np.sort(draw.integers(0, 50, 20_000))
    values = draw.normal(size=len(column))
    values[3_000:3_100] = np.nan
    values[column == 40] = np.nan
    chosen = column_points(column, values)
    assert len(chosen) <= 4 * 50 + 8
    for number in range(50):
        rows = np.flatnonzero(column == number)
        kept = chosen[column[chosen] == number]
        assert {rows[0], rows[-1]} <= set(kept.tolist())
        if number != 40:
            assert np.nanmin(values[kept]) == np.nanmin(values[rows])
            assert np.nanmax(values[kept]) == np.nanmax(values[rows])
    assert {2_999, 3_000, 3_099, 3_100} <= set(chosen.tolist())


def test_a_single_peak_survives_and_the_picture_stays_the_same() -> None:
    time = np.arange(100_000) / 100.0
    values = np.zeros(len(time))
    values[61_803] = 1.0

    def picture(*, thin: bool) -> tuple[int, NDArray[np.int64]]:
        figure = Figure(figsize=(4.0, 2.0), dpi=100)
        (line,) = figure.add_subplot().plot(time, values)
        figure.draw_without_rendering()
        if thin:
            thin_lines(figure)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return len(np.asarray(line.get_xdata())), np.asarray(canvas.buffer_rgba()).astype(np.int64)

    (count, whole), (fewer, thinned) = picture(thin=False), picture(thin=True)
    assert count == 100_000 and fewer < 2_500
    inked, also = (picture[..., :3].min(axis=2) < 200 for picture in (whole, thinned))
    assert np.count_nonzero(inked) > 1_000
    # The same to a pixel: a peak of one point gets the width of a column.
    assert not (inked & ~binary_dilation(also)).any()
    assert not (also & ~binary_dilation(inked)).any()


def test_a_path_that_is_no_function_of_time_is_thinned_too() -> None:
    turn = np.linspace(0.0, 200.0 * np.pi, 300_000)
    figure = Figure(figsize=(3.0, 3.0), dpi=100)
    (line,) = figure.add_subplot().plot(np.cos(turn), np.sin(turn))
    figure.draw_without_rendering()
    thin_lines(figure)
    x, y = (np.asarray(data, dtype=float) for data in (line.get_xdata(), line.get_ydata()))
    assert len(x) <= 4_000
    np.testing.assert_allclose(np.hypot(x, y), 1.0)


def test_noise_and_gaps_in_a_path_do_not_keep_it_from_ending() -> None:
    x, y = np.random.default_rng(7).normal(size=(2, 60_000))
    x[1_000:50_000:2] = np.nan
    figure = Figure(figsize=(3.0, 3.0), dpi=100)
    axes = figure.add_subplot()
    (line,) = axes.plot(x, y)
    axes.set(xlim=(0.5, 1.0), ylim=(0.5, 1.0))
    figure.draw_without_rendering()
    thin_lines(figure)
    assert 2_000 <= len(np.asarray(line.get_xdata())) <= 4_000
