"""What was measured: records of one robot, their files, their frequency responses, and what can be wrong with them."""
