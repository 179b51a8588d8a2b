"""Speed against error: a matrix of runs, measured, drawn and written as a page."""
