// Starts the page.

import { mount } from "svelte";
import "./theme.css";
import App from "./App.svelte";
import { link } from "./page.svelte";
import { place } from "./place.svelte";
// It hears of exercises from the beginning, whichever view is shown first.
import "./training.svelte";
import { load } from "./views/load";

// At once: the stage answers, and the view comes, while the page is being made.
link.connect();
void load[place.view]();
mount(App, { target: document.getElementById("app")! });
