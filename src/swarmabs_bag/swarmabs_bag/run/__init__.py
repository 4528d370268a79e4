"""The steps of a run between its messages and the files of its bag: put in order, summed up, written."""
