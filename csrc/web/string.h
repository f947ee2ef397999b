/* What of C's strings the loop and the twin need; engine.c has them. */
#ifndef FRACLINK_WEB_STRING_H
#define FRACLINK_WEB_STRING_H

#include <stddef.h>

void *memcpy(void *to, const void *from, size_t count);
void *memmove(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

#endif
