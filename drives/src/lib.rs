//! CiA 402 servo drives without I/O.
