"""Many independent calculations: lanes over devices, chunks, worker processes, a store that survives a kill."""
