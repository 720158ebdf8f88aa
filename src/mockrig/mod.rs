//! The far end of a link where no hardware is: firmware, actuator, sensors and a plant. Knows nothing of the daemon.
