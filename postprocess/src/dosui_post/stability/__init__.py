"""The record of hard cases: what must hold, and for which method it does."""
