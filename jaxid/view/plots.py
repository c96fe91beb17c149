"""Channels over time as pictures of Bokeh, whose zoom and cursor go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxid.base.extras import needed
from jaxid.report.plot import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, with_unit


COLORS = (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY)
#: Height of a picture and of the names above it, pixels.
HIGH, LEGEND_HIGH = 230, 45


def color(number: int) -> str:
    """That of a result."""
    return COLORS[number % len(COLORS)]


def channels_over_time(
    series: Mapping[str, Any], units: Mapping[str, str], names: Sequence[str]
) -> Any:
    """Each output as measured and as every result simulates it, and what is left: an item for
    `Bokeh.embed`.
    """
    t = np.asarray(series["t"])
    pictures: list[list[Any]] = []
    shared = Shared()
    for channel, found in series["channels"].items():
        above = shared.figure(with_unit(channel, units[channel]))
        below = shared.figure(with_unit("measured − model", units[channel]))
        measured = np.asarray(found["measured"])
        above.line(t, measured, color=BLACK, line_width=2, legend_label="measured")
        for number, (name, y) in enumerate(zip(names, found["simulated"], strict=True)):
            lines = {"color": color(number), "line_width": 1.4}
            source = shared.source(f"{channel}/{number}", t=t, y=y, left=measured - y)
            above.line("t", "y", source=source, legend_label=name, **lines)
            below.line("t", "left", source=source, **lines)
        shared.legend_outside(above)
        pictures += [[above], [below]]
    return shared.item(pictures)


def lines_over_time(t: np.ndarray, channels: Mapping[str, tuple[np.ndarray, str]]) -> Any:
    """Recorded channels, name -> (values, unit)."""
    shared = Shared(height=150)
    pictures = []
    for name, (values, unit) in channels.items():
        picture = shared.figure(with_unit(name, unit))
        source = shared.source(name, t=t, y=values)
        picture.line("t", "y", source=source, color=BLUE, line_width=1.4)
        pictures.append([picture])
    return shared.item(pictures)


class Shared:
    """Figures with one time axis and one cursor."""

    def __init__(self, height: int = HIGH):
        self._plotting, self._models = needed("bokeh.plotting"), needed("bokeh.models")
        self._range: Any = None
        self._cursor = self._models.Span(dimension="height", line_color="#555555", line_width=1)
        self._height = height

    def figure(self, title: str) -> Any:
        more = {} if self._range is None else {"x_range": self._range}
        made = self._plotting.figure(
            height=self._height,
            sizing_mode="stretch_width",
            tools="xpan,xwheel_zoom,box_zoom,reset,save",
            active_drag="box_zoom",
            x_axis_label="time (s)",
            y_axis_label=title,
            output_backend="canvas",
            **more,
        )
        made.add_tools(self._models.CrosshairTool(overlay=self._cursor))
        self._range = made.x_range
        return made

    def legend_outside(self, picture: Any) -> None:
        """Above the picture, so that it hides no line; a click on a name hides its line."""
        legend = picture.legend[0]
        legend.update(
            click_policy="hide",
            ncols=2,
            padding=2,
            spacing=0,
            border_line_color=None,
            label_text_font_size="12px",
        )
        picture.add_layout(legend, "above")
        picture.height = self._height + LEGEND_HIGH

    def source(self, name: str, **columns: np.ndarray) -> Any:
        """Data that the page may exchange, by their name."""
        data = {key: np.asarray(values, float).tolist() for key, values in columns.items()}
        return self._models.ColumnDataSource(data=data, name=name)

    def item(self, pictures: Sequence[Sequence[Any]]) -> Any:
        from bokeh.core.types import ID
        from bokeh.embed import json_item
        from bokeh.layouts import gridplot

        grid = gridplot(
            [list(row) for row in pictures], sizing_mode="stretch_width", merge_tools=True
        )
        return json_item(grid, ID("plots"))
