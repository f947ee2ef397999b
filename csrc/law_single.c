/* Desktop only: law.c in single precision, under names of its own (see law_single.h). */
#include "law_single.h"
/* The names are defined before the file is included, so that the shipped file itself stays unchanged. */
#include "law.c"
