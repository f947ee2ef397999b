/* What of C's strings the loop and the twin need: WebAssembly copies and fills memory by itself. */
#ifndef FRACLINK_WEB_STRING_H
#define FRACLINK_WEB_STRING_H

#include <stddef.h>

#define memcpy __builtin_memcpy
#define memmove __builtin_memmove
#define memset __builtin_memset

#endif
