"""Read tables of samples from a laboratory, predict values between the samples, and estimate errors."""
