"""The one exception that the command line turns into a message."""


class DosuiPostError(Exception):
    """Something about the files or the request that the user can put right."""
