"""`mbd bench`: what a step costs, and where. suite.py has the cases, stepping.py, phases.py and overhead.py measure,
report.py shows."""
