"""A policy that a controller asks over OPC UA: halfseen is the client, and the controller's variables are all it needs.

Read down: `mapping` (which variable is what) → `controller` (a session: values with their quality and age) → `wire`
(what is asked, answered and recorded, whatever is lost in between).
"""
