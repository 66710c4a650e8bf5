"""The command `cddf`: options in, words out; the work is done by the other rooms."""
