//! Physics that a model may leave out: one file a code of contracts, attached around a plant. Nothing is here yet.
