"""What an operator sees of the service.

`logging` the form of the log; `metrics` counts and times for Prometheus; `readiness` whether it can take work.
"""
