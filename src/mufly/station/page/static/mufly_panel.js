// One panel of the station: a NiceGUI element that hands its place on the page to a module of its own.
export default {
  template: `<div class="mf-panel"></div>`,
  props: { module: String, base: String, options: Object },
  async mounted() {
    const module = await import(`${this.base}/${this.module}.js`);
    if (!this.$el.isConnected) return;
    this.panel = module.mount(this.$el, this.options || {}, (name, content) => this.$emit(name, content));
  },
  unmounted() {
    this.panel?.close?.();
  },
  methods: {
    call(name, ...args) {
      return this.panel?.[name]?.(...args);
    },
  },
};
