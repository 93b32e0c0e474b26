//! Batched ensembles of small networks.
