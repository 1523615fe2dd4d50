"""Results of a fit for people and other programs: stored models, text, figures, exported files."""
