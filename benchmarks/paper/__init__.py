"""The figures of Nishino 2009 on a folder of measurements, a module each; `base` has what they share."""
