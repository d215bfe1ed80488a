"""Links: bytes in and out, frames found in them, signatures checked."""
