"""The loop: what the declared robot lacks, found, judged on records apart, told, and the experiment that comes next."""
