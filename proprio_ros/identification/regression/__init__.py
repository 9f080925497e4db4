"""Payload and arm from any motion: linear regression in weak form, for arms and for single joints."""
