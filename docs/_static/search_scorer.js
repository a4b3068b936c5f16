// Order of search results: pages that explain come before the reference of the Python code and the changelog.
const BEHIND = /^(api\/api-|changelog|contributing|thesis)/;

var Scorer = {
  // result: [docname, title, anchor, description, score, filename]
  score: function (result) {
    const [docname, , , , score] = result;
    return BEHIND.test(docname) ? score - 100 : score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
