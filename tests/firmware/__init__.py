"""Tests of the exported C on this computer and on emulated microcontrollers."""
