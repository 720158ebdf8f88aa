//! Drives a rig over a link: session, lease, command queue, tare, runs. Knows no model, no file, no clock of its own.
