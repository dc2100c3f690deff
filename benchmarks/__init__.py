"""Studies, labelled sets, rivals on them, predictions, and benchmarks of speed."""
