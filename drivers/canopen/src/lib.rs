//! CiA 301 and CiA 402 as sans-I/O objects and tables.
