"""What a scenario consists of; `swarmabs_config.scenario` reads it and checks what involves several settings."""
