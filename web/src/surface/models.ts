/** Adaptive integers on top of the range decoder: spec/cndhf.md, section 4.2. */
import { type RangeDecoder, context, contexts } from "./rangeCoder.js";

const MAX_DIGITS = 21;

/** A model of integers from 0: a function that decodes the next one. */
export function unsignedModel({ bit, raw }: RangeDecoder): () => number {
  const ofDigits = contexts(MAX_DIGITS);
  const below = contexts(4 * MAX_DIGITS);
  return () => {
    let digits = 1;
    while (digits < MAX_DIGITS && bit(ofDigits[digits]!)) digits++;
    let rest = digits - 1;
    let value = 1;
    for (let k = 0; k < 2 && rest; k++, rest--) value = 2 * value + bit(below[4 * (digits - 1) + value]!);
    return (value << rest) + (rest && raw(rest)) - 1;
  };
}

/** A model of integers of both signs. */
export function signedModel(coder: RangeDecoder): () => number {
  const nonzero = context();
  const negative = context();
  const magnitude = unsignedModel(coder);
  return () => {
    if (!coder.bit(nonzero)) return 0;
    const sign = 1 - 2 * coder.bit(negative);
    return sign * (1 + magnitude());
  };
}
