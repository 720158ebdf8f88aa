//! Owns the rig, one run at a time; HTTP, WebSocket and the technician's page.
