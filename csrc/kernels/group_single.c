/* group.c around the single-precision law. */
#include "law_single.h"
#define GROUP_RUN group_run_single
#include "group.c"
