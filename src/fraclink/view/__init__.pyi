from fraclink.view._arm_page import write_arm_page as write_arm_page
from fraclink.view._notebook import draw as draw
from fraclink.view._report import write_report as write_report
from fraclink.view._runs import outcome_figure as outcome_figure

__all__: list[str]
