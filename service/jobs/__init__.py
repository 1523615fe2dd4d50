"""The life of a fit, the engine that computes it and the models kept in memory."""
