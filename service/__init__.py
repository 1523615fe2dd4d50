"""The HTTP service: measurements in, fitted DSBRDF models, their values and their lobes out."""
