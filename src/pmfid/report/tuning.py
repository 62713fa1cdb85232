"""Thresholds, limits and counts of `pmfid.report`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class ReportTuning:
    """One value for each decision of `pmfid.report`, by module."""

    # checks
    max_dots: int = 1200

    # comparison
    #: Most panels in a row; the numbers of more would not fit.
    comparison_panels: int = 4
    #: A fit beyond this [percent] is shown by its size alone.
    comparison_huge: float = 1e5

    # design
    #: chi-square of two degrees of freedom at 95 %.
    design_chi2: float = 5.991

    # figures
    max_points: int = 2000
    figures_width: float = 9.0

    # fleet
    #: Names that are written into a panel, and of a change of so much [%]; rows of the map, and periods of it.
    fleet_names: int = 6
    fleet_shown: float = 2.0
    fleet_rows: int = 50
    fleet_columns: int = 400
    #: Axes whose trend is drawn; letters of a name; rows of the map in which nothing is the matter, to compare with.
    fleet_trends: int = 6
    fleet_longest: int = 24
    fleet_quiet: int = 10
    #: Days of a history from which its times are labelled by the date alone.
    fleet_dates: float = 2.0
    #: Most axes and problems in the tables; the files of the same folder have all.
    fleet_most_axes: int = 60
    fleet_problems: int = 40
    fleet_others: int = 20

    # html
    #: Letters from which on a cell goes over several lines.
    html_long: int = 24

    # monitored
    shown_alarms: int = 200

    # plots
    #: Axes of a fleet that are drawn one by one.
    plots_most_axes: int = 50
    #: Resolution of a figure in a notebook: 9 inches are 900 pixels.
    plots_dpi: int = 100

    # result
    #: Frequencies from a tenth of the slowest to ten times the fastest corner, and time constants of a step response.
    result_decades: float = 1.0
    result_settling: float = 8.0
    result_points: int = 400
    #: Structures in the table of a search.
    result_rows: int = 15

    # terms
    #: Velocities at which a curve is drawn to either side.
    terms_points: int = 400

    # validation
    #: Records that have a figure of their own.
    most_figures: int = 12


TUNING = ReportTuning()
