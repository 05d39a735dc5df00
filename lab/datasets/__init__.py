"""The data sets of the papers, recorded on simulated devices."""
