"""Lets `python -m dosui_post` do what the command `dosui-post` does."""

import sys

from dosui_post.cli import main

sys.exit(main())
