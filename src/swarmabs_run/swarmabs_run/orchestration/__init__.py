"""Running a scenario as one process per node over DDS, in lockstep or in real time."""
