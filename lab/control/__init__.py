"""Closed-loop benchmark: every controller on every plant along every motion, compared with bars."""
