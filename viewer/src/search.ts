// Places in lists that are in order.

/** How many of the first `length` come before the first one that is not `below`. */
export function lowerBound(length: number, below: (index: number) => boolean): number {
  let [low, high] = [0, length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (below(middle)) low = middle + 1;
    else high = middle;
  }
  return low;
}
