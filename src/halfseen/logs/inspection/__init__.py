"""What `halfseen inspect` tells of a log: its `breakdown`, `units` that look mixed, and other `suspicions`."""
