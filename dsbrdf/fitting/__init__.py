"""From profiles to a model and a report, and from a model to its components."""
