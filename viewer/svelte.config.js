// Types are all that the components have of TypeScript: the compiler takes them out by itself.
export default {};
