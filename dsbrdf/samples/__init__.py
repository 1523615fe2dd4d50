"""Tables of samples from a laboratory: reading, prediction between the samples, and errors."""
