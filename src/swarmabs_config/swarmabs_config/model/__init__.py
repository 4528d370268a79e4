"""What a scenario consists of; `swarmabs_config.scenario` reads it and checks what involves several settings."""

import os

# pydantic would otherwise search all installed packages for plug-ins of its own, which takes longer than a scenario.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
