"""Thresholds, limits and counts of `pmfid.report`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class ReportTuning:
    """All thresholds of `pmfid.report`, ordered by module."""

    # figures
    max_points: int = 2000
    figures_width: float = 9.0
    #: Width of a figure [inch] on a phone, and number of points of a smooth curve, of a curve on a phone, and of
    #: periods in a map.
    figures_phone: float = 4.5
    figures_points: int = 800
    #: Longest label of a legend with two columns, and longest line of the label of an axis on a phone.
    figures_label: int = 18
    figures_line: int = 48

    # fleet
    #: Numbers of drawn trends, and of quiet rows for comparison in the map.
    fleet_trends: int = 6
    fleet_quiet: int = 10
    #: Least length of a history [days] whose times have only dates as labels.
    fleet_dates: float = 2.0
    #: Largest number of rows in a table or a map, and of axes that are drawn individually. Files next to the report
    #: have all axes and problems.
    fleet_listed: int = 50

    # html
    #: Number of letters of a name in a figure, and of a cell from which it may be broken into several lines.
    html_long: int = 24

    # monitored
    shown_alarms: int = 200
    #: Largest number of rows in the figures.
    monitored_rows: int = 8000

    # result
    #: Frequencies from a tenth of the slowest to ten times the fastest corner, and time constants of a step response.
    result_decades: float = 1.0
    result_settling: float = 8.0
    #: Number of structures in the table of a search.
    result_rows: int = 15

    # validation
    #: Largest number of records that have their own figure.
    most_figures: int = 12


TUNING = ReportTuning()
