/* law_port.c around the single-precision law. */
#include "law_single.h"
#define LAW_PORT LAW_IN_SINGLE
#include "law_port.c"
