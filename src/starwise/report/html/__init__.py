"""Reports as single HTML files: nothing is fetched, everything from an input is escaped, plotly draws.

Only plotly's script is used, out of the installed package; its Python part is slow to load and is not imported.
"""

from starwise.report.html.compare import Compared, compare_page
from starwise.report.html.files import refresh_reports, write_page, write_report, write_study
from starwise.report.html.run import run_page
from starwise.report.html.simulation import simulation_page
from starwise.report.html.study import study_page

__all__ = [
    "Compared",
    "compare_page",
    "refresh_reports",
    "run_page",
    "simulation_page",
    "study_page",
    "write_page",
    "write_report",
    "write_study",
]
