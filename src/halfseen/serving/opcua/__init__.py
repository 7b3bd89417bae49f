"""A policy that a controller asks over OPC UA: halfseen is the client, and needs only the controller's variables.

Reading order: `mapping` (the role of each variable) → `controller` (a session: values with their quality and age) →
`wire` (requests, answers and recording, robust to lost messages).
"""
