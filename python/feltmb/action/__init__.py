"""Piano actions: touch, regulation and the key actuator."""
