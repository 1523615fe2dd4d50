"""The method of the paper: Algorithm 1 on slices, and the choice of the number of lobes by Williams' test."""
