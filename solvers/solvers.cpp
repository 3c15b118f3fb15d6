// Keeps the library from being empty while no process is configured.
