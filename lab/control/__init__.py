"""The closed-loop benchmark: every controller on every plant along every motion, against bars."""
