"""Settings of nbgrader for this course: sources in source/, student copies in release/."""

from pathlib import Path

c = get_config()  # noqa: F821 - nbgrader defines it
c.CourseDirectory.course_id = "mireach"
c.CourseDirectory.root = str(Path(__file__).resolve().parent)
c.ClearSolutions.code_stub = {"python": "# your answer here"}  # copies run from top to bottom before they are filled in
