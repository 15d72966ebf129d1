"""Linear algebra of the step: elimination order, supernodal Cholesky factors, small bounded systems."""
