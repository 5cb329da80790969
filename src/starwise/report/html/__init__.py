"""Reports as single HTML files: nothing is fetched, everything from an input is escaped, plotly draws.

Only plotly's script is used, out of the installed package; its Python part is slow to load and is not imported.
"""

from starwise.report.html.run import run_page

__all__ = ["run_page"]
