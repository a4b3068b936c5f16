"""Files: input files of users, text tables, and the store of computed answers."""
