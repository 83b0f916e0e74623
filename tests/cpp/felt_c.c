/* The C interface from C: a felt is made, pressed, saved and restored. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "feltmb_felt.h"

#define CHECK(x)                                    \
  if (!(x)) {                                       \
    fprintf(stderr, "line %d: %s\n", __LINE__, #x); \
    return 1;                                       \
  }

static const char* TEXT =
    "law felt_return_point\n"
    "kappa 0.3   # transition over the loop\n"
    "loading 5520 1580 -600\n"
    "unloading 190 5040 3040\n";

int main(void) {
  char message[256] = "";
  double saved[16], top, inner, work = 0.0, before = 0.0;
  size_t count;
  int i;
  feltmb_felt* other;
  feltmb_felt* felt = feltmb_felt_create(TEXT, message, sizeof message);
  CHECK(felt != NULL);
  top = feltmb_felt_step(felt, 0.8e-3, 1e-3);
  CHECK(fabs(top - (5520 * exp(1580 * 0.8e-3) - 600) * 0.8e-3) < 1e-12 * top);
  inner = feltmb_felt_step(felt, 0.4e-3, 1e-3);
  CHECK(inner < 0.5 * top);
  /* A closed loop ends at its force. */
  CHECK(feltmb_felt_step(felt, 0.5e-3, 1e-3) > inner);
  count = feltmb_felt_save(felt, saved, 16);
  CHECK(count == 4 && feltmb_felt_save(felt, NULL, 0) == 4);
  CHECK(fabs(feltmb_felt_step(felt, 0.4e-3, 1e-3) - inner) < 1e-12 * inner);
  other = feltmb_felt_copy(felt);
  feltmb_felt_reset(other);
  CHECK(feltmb_felt_energy(other) == 0.0);
  CHECK(!feltmb_felt_restore(other, saved, 2));
  CHECK(feltmb_felt_restore(other, saved, count));
  CHECK(feltmb_felt_force(other) == saved[count - 1]);
  CHECK(feltmb_felt_peek(other, 0.4e-3, 1e-3) == feltmb_felt_step(other, 0.4e-3, 1e-3));
  /* What it stores it gives back. */
  feltmb_felt_restore(other, saved, count);
  for (i = 1; i <= 1000; ++i) {
    const double last = i == 1 ? saved[count - 1] : before;
    before = feltmb_felt_step(other, 0.5e-3 * (1000 - i) / 1000, 1e-3);
    if (i == 1) work = 0.0;
    work += 0.5 * (last + before) * 0.5e-6;
  }
  feltmb_felt_restore(other, saved, count);
  CHECK(fabs(work - feltmb_felt_energy(other)) < 1e-5 * work);
  CHECK(isnan(feltmb_felt_step(other, NAN, 1.0)) && isnan(feltmb_felt_peek(other, 0.0, 0.0)));
  CHECK(feltmb_felt_create("law felt_return_point\nloading 1 2\n", message, sizeof message) ==
        NULL);
  CHECK(strstr(message, "loading") != NULL);
  CHECK(feltmb_felt_create("law hunt_crossley\nstifness 1\n", message, sizeof message) == NULL);
  CHECK(strstr(message, "stifness") != NULL);
  /* Two curves that do not meet have the end of Python's closing_compression. */
  feltmb_felt_free(other);
  other = feltmb_felt_create(
      "law felt_return_point\nloading 5e3 1e3 0\nunloading 1e3 1e3 0\nclosing_compression 1e-3\n",
      message, sizeof message);
  CHECK(other != NULL);
  CHECK(fabs(feltmb_felt_step(other, 1e-3, 1.0) - 5 * exp(1)) < 1e-12);
  CHECK(feltmb_felt_create("law felt_return_point\nloading 5e3 1e3 0\nunloading 1e3 1e3 0\n"
                           "closing 1e-3\n",
                           message, sizeof message) == NULL);
  /* A hammer of 9 g in two steps of an engine. */
  {
    double x = 0.0, v = 2.0;
    feltmb_felt_reset(other);
    CHECK(feltmb_felt_hit(other, 9e-3, &x, &v, 1.0 / 240) > 0.0);
    feltmb_felt_hit(other, 9e-3, &x, &v, 1.0 / 240);
    CHECK(x < 0.0 && v < 0.0 && v > -2.0);
    CHECK(isnan(feltmb_felt_hit(other, 0.0, &x, &v, 1.0 / 240)) && x < 0.0);
  }
  feltmb_felt_free(felt);
  feltmb_felt_free(other);
  printf("ok: %.6f N\n", top);
  return 0;
}
