//! A recorder that steps a plant and passes each sample on with the twin's force.
