"""The sections of a report, a file each: what was found in a run's folder -> a heading with blocks below it.

A section is a function `(material) -> Section`; `report.SECTIONS` is their order on the page. Its blocks are plain
data, which `templates/section.html` draws; a section that needs other HTML names its own template.
"""
