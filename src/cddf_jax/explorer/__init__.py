"""The interactive page: a model of what is shown, its plots, its words, the server."""
