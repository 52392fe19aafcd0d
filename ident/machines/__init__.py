"""Around a real machine: a robot directory to start from, the doctor before a campaign, what to play, files of other programs."""
